# ruff: noqa: TID252 (lazy_loader reads relative imports only)
from .accumulation import (
    AccumulatedRadiance,
    accumulate,
    feature_similarity,
    fill_holes,
    frame_radiance,
    surface_features,
)
from .affinity import affinity_sum, cross_affinity_sum
from .antilag import history_confidence
from .asking import is_compiling, is_recorded, may_ask, next_age
from .color import OIDN_LUMINANCE, REC709_LUMINANCE, decode_srgb, encode_srgb, luminance
from .demodulation import (
    demodulation_albedo,
    filtered_albedo,
    reflectance,
    surface_mask,
)
from .density import bounded_exp_density
from .dither import round_to_total
from .exposure import autoexposure, log_average
from .fireflies import (
    limit_fireflies,
    mean_without_fireflies,
    repair_light,
    repair_radiance_history,
)
from .init import kaiming_init
from .kernels import apply_kernels, splat_kernels
from .losses import (
    display_mse,
    l1,
    l1_ms_ssim_loss,
    log_loss,
    log_transfer_loss,
    ms_ssim,
    smape,
    temporal_l1,
)
from .memory_format import to_channels_last, to_contiguous_float32
from .padded_rows import PaddedRows, read_windows
from .padding import crop, pad
from .radiance_history import (
    find_static_pixels,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from .reprojection import reproject, reproject_bicubic, reproject_or_fill
from .sanitize import (
    repair_history,
    sanitize_albedo,
    sanitize_depth,
    sanitize_motion,
    sanitize_normal,
    sanitize_radiance,
)
from .stencils import Stencil, Tap, atrous_stencil
from .surface_taps import SurfaceTaps, find_surface_taps
from .transfer import log_forward, log_inverse, pu_forward, pu_inverse, squash_depth
from .unet import UNet
from .upsample import UpsampleConcatConv

__all__ = [
    "OIDN_LUMINANCE",
    "REC709_LUMINANCE",
    "AccumulatedRadiance",
    "PaddedRows",
    "SurfaceTaps",
    "Stencil",
    "Tap",
    "UNet",
    "UpsampleConcatConv",
    "accumulate",
    "affinity_sum",
    "apply_kernels",
    "atrous_stencil",
    "autoexposure",
    "bounded_exp_density",
    "crop",
    "cross_affinity_sum",
    "decode_srgb",
    "demodulation_albedo",
    "display_mse",
    "encode_srgb",
    "feature_similarity",
    "fill_holes",
    "filtered_albedo",
    "find_surface_taps",
    "frame_radiance",
    "history_confidence",
    "kaiming_init",
    "l1",
    "l1_ms_ssim_loss",
    "limit_fireflies",
    "log_average",
    "log_forward",
    "log_inverse",
    "log_loss",
    "log_transfer_loss",
    "luminance",
    "mean_without_fireflies",
    "ms_ssim",
    "pad",
    "pu_forward",
    "pu_inverse",
    "read_windows",
    "reflectance",
    "repair_history",
    "repair_light",
    "repair_radiance_history",
    "reproject",
    "reproject_bicubic",
    "reproject_or_fill",
    "round_to_total",
    "sanitize_albedo",
    "sanitize_depth",
    "sanitize_motion",
    "sanitize_normal",
    "sanitize_radiance",
    "smape",
    "splat_kernels",
    "squash_depth",
    "surface_features",
    "surface_mask",
    "temporal_l1",
    "to_channels_last",
    "to_contiguous_float32",
    "find_static_pixels",
    "repair_spp",
    "reproject_radiance",
    "weigh_by_similarity",
    "is_compiling",
    "is_recorded",
    "may_ask",
    "next_age",
]

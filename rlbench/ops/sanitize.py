"""Sanitising: invalid values of radiance and G-buffer, replaced by one rule for each.

Valid values are returned unchanged, and a tensor without invalid values without a copy. The core
applies these rules before a method reads a frame (rlbench.sanitize).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.transfer import HALF_MAX

__all__ = [
    "RULES",
    "sanitize_albedo",
    "sanitize_depth",
    "sanitize_motion",
    "sanitize_normal",
    "sanitize_radiance",
]

MAX_SQUARED_NORMAL = 1.02  # half floats and interpolation make unit normals a little longer
OUTSIDE = 2.0  # image sizes that repaired motion points away


def sanitize_radiance(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Radiance clamped to [0, 65504]; black where any channel is not finite.

    65504 is the largest half float; the square of the result is finite in float32.
    """
    if _is_within(radiance, 0.0, HALF_MAX):
        return radiance
    finite = radiance.isfinite().all(-3, keepdim=True)
    return torch.where(finite, radiance, 0.0).clamp(0, HALF_MAX)


def sanitize_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Albedo clamped to [0, 1]; 0 where it is not finite."""
    if _is_within(albedo, 0.0, 1.0):
        return albedo
    return albedo.where(albedo.isfinite(), 0.0).clamp(0, 1)


def sanitize_normal(normal: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Normals scaled to unit length where they are longer; zero where any channel is not finite.

    Shorter normals stay: an average over a pixel is shorter than 1, and background has none.
    """
    if bool(normal.square().sum(1).amax() <= MAX_SQUARED_NORMAL):  # False for NaN
        return normal
    normal = normal.where(normal.isfinite().all(1, keepdim=True), 0.0)
    scale = normal.abs().amax(1, keepdim=True).clamp_min(1)  # squares must not overflow
    is_long = (normal / scale).square().sum(1, keepdim=True) > MAX_SQUARED_NORMAL / scale.square()
    return torch.where(is_long, F.normalize(normal / scale, dim=1), normal)


def sanitize_depth(depth: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Depth, or +inf (background) where it is NaN or not above 0."""
    if bool((depth > 0).all()):  # False for NaN
        return depth
    return depth.where(depth > 0, torch.inf)


def sanitize_motion(motion: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
    """Motion, or a point outside the image where it is not finite: the pixel has no history."""
    if _is_within(motion, -torch.finfo(motion.dtype).max, torch.finfo(motion.dtype).max):
        return motion
    return motion.where(motion.isfinite().all(1, keepdim=True), OUTSIDE * max(motion.shape[-2:]))


RULES: Mapping[str, Callable[[Tensor], Tensor]] = {  # by the first word of a buffer's name
    "albedo": sanitize_albedo,
    "normal": sanitize_normal,
    "depth": sanitize_depth,
    "motion": sanitize_motion,
}


def _is_within(values: Tensor, low: float, high: float) -> bool:
    """Whether all values lie in [low, high]; False for NaN. One pass over the values."""
    if not values.numel():
        return True
    least, most = values.aminmax()
    return bool((least >= low) & (most <= high))

"""The shipped metrics."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

from metrics.metric import Comparison, Metric

__all__ = ["BIAS", "MSE_DEBIASED", "MS_SSIM", "NONFINITE", "PSNR", "RELMSE", "TPSNR"]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


def _psnr(frame: Comparison) -> Tensor:
    from metrics.image import psnr

    return psnr(frame.image, frame.reference)


def _tpsnr(frame: Comparison) -> Tensor:
    from metrics.temporal import tpsnr

    previous: Any = frame.previous
    return tpsnr(frame.display_error, previous.display_error)


def _relmse(frame: Comparison) -> Tensor:
    from metrics.image import relmse

    return relmse(frame.image, frame.reference)


def _mse_debiased(frame: Comparison) -> Tensor:
    from metrics.image import mse_debiased

    return mse_debiased(frame.image, frame.half_a, frame.half_b)


def _bias(frame: Comparison) -> Tensor:
    from metrics.image import bias

    return bias(frame.image, frame.reference)


def _nonfinite(frame: Comparison) -> Tensor:
    from metrics.image import nonfinite

    return nonfinite(frame.image)


def _ms_ssim(frame: Comparison, scales: int) -> Tensor:
    from metrics.image import ms_ssim

    return ms_ssim(frame.image, frame.reference, scales)


def _undefined(frame: Comparison) -> Tensor:
    return frame.image.new_full(frame.image.shape[:1], math.nan)


def _ms_ssim_at(height: int, width: int) -> Metric:
    """MS-SSIM with as many scales as fit, named ms_ssim_4 to ms_ssim_1; NaN if none fits."""
    from metrics.image import max_scales

    scales = max_scales(height, width)
    if scales == 5:
        return MS_SSIM
    if scales == 0:
        return replace(MS_SSIM, convention="not defined below 11 pixels", score=_undefined)
    return replace(
        MS_SSIM,
        name=f"ms_ssim_{scales}",
        convention=f"{scales} of 5 scales, as sides are 160 pixels or less; {_SSIM_CONVENTION}",
        score=partial(_ms_ssim, scales=scales),
    )


_SSIM_CONVENTION = "pytorch-msssim, clipped sRGB, range 1, window 11, sigma 1.5"

PSNR = Metric(
    "psnr", "dB", "higher", "peak 1, clipped sRGB, 1.0 = display white, at most 100 dB", _psnr
)
TPSNR = Metric(
    "tpsnr",
    "dB",
    "higher",
    "of the change from frame to frame, not moved; peak 1, clipped sRGB, at most 100 dB",
    _tpsnr,
    previous_frames=1,
)
MS_SSIM = Metric(
    "ms_ssim",
    "",
    "higher",
    f"5 scales; {_SSIM_CONVENTION}",
    partial(_ms_ssim, scales=5),
    _ms_ssim_at,
    requires=("pytorch-msssim",),
)
RELMSE = Metric("relmse", "", "lower", "linear radiance, per channel, reference^2 + 0.01", _relmse)
MSE_DEBIASED = Metric(
    "mse_debiased",
    "",
    "lower",
    "linear radiance, mean((x-a)(x-b)) of half references",
    _mse_debiased,
    needs_reference_halves=True,
)
BIAS = Metric(
    "bias",
    "%",
    "",
    "linear radiance, (mean of image - mean of reference) / mean of reference; best at 0",
    _bias,
)
NONFINITE = Metric(
    "nonfinite", "pixels", "lower", "pixels with a NaN or infinite channel", _nonfinite
)

"""The shipped metrics: each has a name, a unit, a direction, a convention, and a score function."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

__all__ = ["BIAS", "MSE_DEBIASED", "MS_SSIM", "NONFINITE", "PSNR", "RELMSE", "TPSNR", "Metric"]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast
Score = Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Metric:
    """A metric: one number for each image of a batch.

    `score(image, half_a, half_b)` takes the image and the two independent halves of its reference,
    all [n 3 h w] in linear radiance where 1.0 is display white, and returns [n]. Scores are finite
    for any image; they are NaN only at a size for which the metric is undefined. The halves must be
    finite. A `temporal` metric takes two frames of each, the previous and the current one,
    [n 2 3 h w]; the first frame of a clip has no score.

    >>> import torch
    >>> mean_error = Metric(
    ...     name="l1",
    ...     unit="",
    ...     direction="lower",
    ...     convention="linear radiance, mean of absolute differences",
    ...     score=lambda image, a, b: (image - (a + b) / 2).abs().mean((1, 2, 3)),
    ... )
    >>> black, white = torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8)
    >>> mean_error.score(black, white, white)
    tensor([1.])
    """

    name: str
    unit: str  # "dB", or empty for a plain number
    direction: str  # "higher" or "lower" is better; empty for a signed error, best at zero
    convention: str  # what is needed to reproduce the number: colour space, peak, window
    score: Score
    fit: Callable[[int, int], Metric] | None = None  # (height, width) to the metric at that size
    needs_reference_halves: bool = False  # undefined unless the halves are independent
    temporal: bool = False  # compares the change from the previous frame
    requires: tuple[str, ...] = ()  # Python distributions; a new version invalidates old scores

    def at(self, height: int, width: int) -> Metric:
        """The metric to use at an image size: this one, or its substitute for small images.

        A substitute has a different name, because its numbers are not comparable.

        >>> MS_SSIM.at(1080, 1920).name, MS_SSIM.at(96, 128).name
        ('ms_ssim', 'ms_ssim_4')
        """
        return self.fit(height, width) if self.fit else self


def _psnr(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import psnr

    return psnr(image, (half_a + half_b) / 2)


def _tpsnr(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import tpsnr

    return tpsnr(image, (half_a + half_b) / 2)


def _relmse(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import relmse

    return relmse(image, (half_a + half_b) / 2)


def _mse_debiased(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import mse_debiased

    return mse_debiased(image, half_a, half_b)


def _bias(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import bias

    return bias(image, (half_a + half_b) / 2)


def _nonfinite(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    from metrics.image import nonfinite

    return nonfinite(image)


def _ms_ssim(image: Tensor, half_a: Tensor, half_b: Tensor, scales: int) -> Tensor:
    from metrics.image import ms_ssim

    return ms_ssim(image, (half_a + half_b) / 2, scales)


def _undefined(image: Tensor, half_a: Tensor, half_b: Tensor) -> Tensor:
    return image.new_full(image.shape[:1], math.nan)


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
    temporal=True,
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

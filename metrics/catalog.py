"""The metrics that ship: each a name, a direction, a convention, and a score for every image."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

Tensor = Any  # torch.Tensor; torch is imported at the first score, so that listing stays fast
Score = Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Metric:
    """A number for each image of a batch.

    `score(image, a, b)` takes the image and both independent halves of its reference, [n 3 h w] of
    linear radiance where 1.0 is display white, and returns [n]. Scores are finite, whatever the
    image holds, or NaN at a size at which there are none; the halves must be finite. `fit(height,
    width)` is the metric that is defined at that size, under a name of its own, where not every
    size is. One that is `temporal` takes two frames of each, the one before and this one,
    [n 2 3 h w]; a clip's first frame has no score.
    """

    name: str
    unit: str  # "dB", or empty for a plain number
    direction: str  # "higher" or "lower" is better; empty for a signed error, best at zero
    convention: str  # what must be known to reproduce the number
    score: Score
    fit: Callable[[int, int], Metric] | None = None
    needs_reference_halves: bool = False  # is it only defined where `a` and `b` are independent?
    temporal: bool = False  # does it look at the frame before, too?
    requires: tuple[str, ...] = ()  # distributions that make its scores; measured anew with others

    def at(self, height: int, width: int) -> Metric:
        """This metric, or the one that stands in for it at a size at which it is not defined."""
        return self.fit(height, width) if self.fit else self


def _psnr(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import psnr

    return psnr(image, (a + b) / 2)


def _tpsnr(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import tpsnr

    return tpsnr(image, (a + b) / 2)


def _relmse(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import relmse

    return relmse(image, (a + b) / 2)


def _mse_debiased(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import mse_debiased

    return mse_debiased(image, a, b)


def _bias(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import bias

    return bias(image, (a + b) / 2)


def _nonfinite(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    from metrics.image import nonfinite

    return nonfinite(image)


def _ms_ssim(image: Tensor, a: Tensor, b: Tensor, scales: int) -> Tensor:
    from metrics.image import ms_ssim

    return ms_ssim(image, (a + b) / 2, scales)


def _undefined(image: Tensor, a: Tensor, b: Tensor) -> Tensor:
    return image.new_full(image.shape[:1], math.nan)


def _ms_ssim_at(height: int, width: int) -> Metric:
    """MS-SSIM of as many scales as fit; fewer than five are named in the name, of none is NaN."""
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

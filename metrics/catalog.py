"""The shipped metrics."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from metrics.metric import Comparison, Metric

if TYPE_CHECKING:
    from metrics.conventions import Convention

__all__ = [
    "BIAS",
    "BLOTCHES",
    "MSE",
    "MSE_DEBIASED",
    "MS_SSIM",
    "NONFINITE",
    "PSNR",
    "PSNR_DEBIASED",
    "RELMSE",
    "RELMSE_TRIMMED",
    "SMAPE",
    "SSIM",
    "TPSNR",
]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


def _mse(frame: Comparison, convention: Convention | None = None) -> Tensor:
    from metrics.psnr import mse

    return mse(*frame.encode(convention), frame.nonfinite_mask)


def _psnr(frame: Comparison, convention: Convention | None = None) -> Tensor:
    from metrics.conventions import SRGB
    from metrics.psnr import psnr

    pair = frame.encode(convention)
    return psnr(*pair, frame.nonfinite_mask, (convention or SRGB).peak(pair.reference))


def _psnr_debiased(frame: Comparison) -> Tensor:
    from metrics.psnr import psnr_debiased

    return psnr_debiased(frame.display_image, *frame.truth.display_halves, frame.nonfinite_mask)


def _blotches(frame: Comparison) -> Tensor:
    from metrics.blotches import blotches

    return blotches(frame.display_image, frame.truth.display_band, frame.nonfinite_mask)


def _tpsnr(frame: Comparison) -> Tensor:
    from metrics.temporal import tpsnr

    previous: Any = frame.previous
    return tpsnr(frame.display_error, previous.display_error)


def _ssim(frame: Comparison, convention: Convention | None = None) -> Tensor:
    return frame.similarity(convention).ssim


def _relmse(frame: Comparison) -> Tensor:
    from metrics.image import relmse

    return relmse(*frame.linear)


def _relmse_trimmed(frame: Comparison) -> Tensor:
    from metrics.image import relmse_trimmed

    return relmse_trimmed(*frame.linear, frame.nonfinite_mask)


def _smape(frame: Comparison) -> Tensor:
    from metrics.image import smape

    return smape(*frame.linear, frame.nonfinite_mask)


def _mse_debiased(frame: Comparison) -> Tensor:
    from metrics.image import mse_debiased

    return mse_debiased(frame.linear.image, *frame.truth.bounded_halves)


def _bias(frame: Comparison) -> Tensor:
    from metrics.image import bias

    return bias(*frame.linear)


def _nonfinite(frame: Comparison) -> Tensor:
    from metrics.image import nonfinite

    return nonfinite(frame.image)


def _ms_ssim(frame: Comparison, scales: int, convention: Convention | None = None) -> Tensor:
    from metrics.ssim import combine_scales

    image, windows = frame.encode(convention).image, frame.truth.windows(convention, scales)
    return combine_scales(image, windows, frame.similarity(convention))


def _undefined(frame: Comparison, convention: Convention | None = None) -> Tensor:
    return frame.image.new_full(frame.image.shape[:1], math.nan)


def _ssim_at(height: int, width: int) -> Metric:
    from metrics.ssim import max_scales

    return SSIM if max_scales(height, width) else replace(SSIM, fit=None, **_TOO_SMALL)


def _ms_ssim_at(height: int, width: int) -> Metric:
    """MS-SSIM with as many scales as fit, named ms_ssim_4 to ms_ssim_1; NaN if none fits."""
    from metrics.ssim import max_scales

    scales = max_scales(height, width)
    if scales == 5:
        return replace(MS_SSIM, fit=None)
    if scales == 0:
        return replace(MS_SSIM, fit=None, **_TOO_SMALL)
    return replace(
        MS_SSIM,
        name=f"ms_ssim_{scales}",
        convention=f"{scales} of 5 scales, as sides are 160 pixels or less; {_SSIM_CONVENTION}",
        score=partial(_ms_ssim, scales=scales),
        fit=None,
    )


_TOO_SMALL: dict[str, Any] = {"convention": "not defined below 11 pixels", "score": _undefined}
_SSIM_CONVENTION = "clipped sRGB, range 1, window 11, sigma 1.5"
_DISPLAY = "peak 1, clipped sRGB, 1.0 = display white"

PSNR = Metric(
    "psnr",
    "dB",
    "higher",
    f"{_DISPLAY}, at most 100 dB",
    _psnr,
    takes_convention=True,
    pixelwise=True,
    source="mean squared error of clipped sRGB, the peak of Scardigli et al. 2023 fixed at 1",
)
PSNR_DEBIASED = Metric(
    "psnr_debiased",
    "dB",
    "higher",
    f"{_DISPLAY}, of mean((x-a)(x-b)) with half references, at most 100 dB",
    _psnr_debiased,
    needs_reference_halves=True,
    pixelwise=True,
    source="this project; halves as in mse_debiased",
)
BLOTCHES = Metric(
    "blotches",
    "%",
    "lower",
    "RMS error at wavelengths of 5 to 12 pixels where the reference is smooth, of the range of "
    "clipped sRGB, without the noise of the half references",
    _blotches,
    needs_reference_halves=True,
    source="this project; halves as in mse_debiased, masking of Teo and Heeger 1994",
)
MSE = Metric(
    "mse",
    "",
    "lower",
    _DISPLAY,
    _mse,
    takes_convention=True,
    scored_by_run=False,  # it is psnr without the logarithm
    pixelwise=True,
    source="mean squared error of clipped sRGB",
)
TPSNR = Metric(
    "tpsnr",
    "dB",
    "higher",
    "of the change from frame to frame, not moved; peak 1, clipped sRGB, at most 100 dB",
    _tpsnr,
    previous_frames=1,
    pixelwise=True,
    source="temporal loss of Chaitanya et al. 2017, as a PSNR",
)
SSIM = Metric(
    "ssim",
    "",
    "higher",
    _SSIM_CONVENTION,
    _ssim,
    _ssim_at,
    takes_convention=True,
    source="Wang, Bovik, Sheikh, Simoncelli 2004",
)
MS_SSIM = Metric(
    "ms_ssim",
    "",
    "higher",
    f"5 scales; {_SSIM_CONVENTION}",
    partial(_ms_ssim, scales=5),
    _ms_ssim_at,
    takes_convention=True,
    source="Wang, Simoncelli, Bovik 2003",
)
RELMSE = Metric(
    "relmse",
    "",
    "lower",
    "linear radiance, per channel, reference^2 + 0.01",
    _relmse,
    pixelwise=True,
    source="Rousselle, Knaus, Zwicker 2011",
)
RELMSE_TRIMMED = Metric(
    "relmse_trimmed",
    "",
    "lower",
    "relmse of radiance over the reference's mean, without the worst 0.1 % of finite pixels",
    _relmse_trimmed,
    pixelwise=True,
    source="relmse; the trimming and the division are this project's",
)
SMAPE = Metric(
    "smape",
    "",
    "lower",
    "linear radiance, per channel, |x-r| / (|x| + |r| + 0.01)",
    _smape,
    pixelwise=True,
    source="Vogels et al. 2018",
)
MSE_DEBIASED = Metric(
    "mse_debiased",
    "",
    "lower",
    "linear radiance, mean((x-a)(x-b)) of half references",
    _mse_debiased,
    needs_reference_halves=True,
    pixelwise=True,
    source="this project: the product of two independent errors",
)
BIAS = Metric(
    "bias",
    "%",
    "",
    "linear radiance, (mean of image - mean of reference) / mean of reference; best at 0",
    _bias,
    pixelwise=True,
    source="relative error of the mean",
)
NONFINITE = Metric(
    "nonfinite",
    "pixels",
    "lower",
    "pixels with a NaN or infinite channel",
    _nonfinite,
    needs_reference=False,
    pixelwise=True,
    source="a count",
)

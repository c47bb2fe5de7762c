"""Blotches: slow ripples, streaks and stains that a denoiser paints on smooth surfaces.

The eye sees them before it sees noise, while PSNR hardly counts them: they are faint, and most of
its error lies at edges. So the error is filtered to the wavelengths of blotches, and counted where
the reference is smooth at these wavelengths. Two independent halves of the reference take the place
of the truth, so that its noise, which is stronger than the blotches, drops out of the mean.

The filter is the second band of the a-trous wavelet with the B3 spline (Starck and Murtagh 1998;
Dammertz et al. 2010 denoise with the same taps).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

__all__ = ["ReferenceBand", "blotches", "filter_band", "reference_band"]

TAPS = (6 / 16, 4 / 16, 1 / 16)  # of the B3 spline, from the centre to either side
PEAK_GAIN = 0.5596460703665476  # max of cos(w/2)^4 (1 - cos(w)^4), at 7.1 pixels
STRUCTURE = 0.02  # RMS of the reference in the band, of which a pixel counts a quarter
WORST = 1.0  # squared error of a pixel that is not finite


class ReferenceBand(NamedTuple):
    """A reference in the band, and how much each pixel counts."""

    half_a: Float[Tensor, "n 3 h w"]
    half_b: Float[Tensor, "n 3 h w"]
    weight: Float[Tensor, "n 1 h w"]  # in (0, 1]: 1 where the reference is smooth


def blotches(
    display_image: Float[Tensor, "n 3 h w"],
    reference: ReferenceBand,
    nonfinite: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Blotches in percent of the display's range; lower is better, 0 is best.

    The root of the weighted mean of (f(x) - f(a)) (f(x) - f(b)) over pixels and channels: x is the
    image, a and b are independent halves of its reference, all in clipped sRGB, f is `filter_band`,
    and the weights are those of `reference_band`. A uniform or slowly varying error is no blotch. A
    wave of amplitude 1 % and 7 pixels that is painted on a smooth wall scores 0.7, noise of
    standard deviation 1 % scores 0.36. A mean below zero, where the error is too small for
    the reference to resolve, scores 0. A pixel that is not finite has the error 1.

    What noise in the halves leaves: their product also enters the weights, which lowers the score:
    on clips of three scenes by up to 6 % of itself where each half has noise of 4 % of the range,
    and by 6 to 13 % at 8 %.

    >>> x = torch.arange(64) * 2 * torch.pi / 7.1
    >>> wall = torch.full((1, 3, 64, 64), 0.5)
    >>> band, valid = reference_band(wall, wall), torch.zeros(1, 1, 64, 64, dtype=torch.bool)
    >>> blotches(wall + 0.01 * x.sin(), band, valid), blotches(wall + 0.1, band, valid)
    (tensor([0.6839]), tensor([0.]))
    """
    band = filter_band(display_image)
    error = ((band - reference.half_a) * (band - reference.half_b)).mean(1, keepdim=True)
    if nonfinite.any():
        error = error.masked_fill(nonfinite, WORST)
    total = (error * reference.weight).flatten(1).sum(1, dtype=torch.float64)
    mean = total / reference.weight.flatten(1).sum(1, dtype=torch.float64)
    return (100 * mean.clamp_min(0).sqrt()).float()


def reference_band(
    display_a: Float[Tensor, "n 3 h w"], display_b: Float[Tensor, "n 3 h w"]
) -> ReferenceBand:
    """Two halves of a reference, in clipped sRGB, in the band, and the weights of pixels.

    The weight is 1 / (1 + (s / 2 %)^2)^2, where s^2 is the variance of the truth in the band, mean
    over channels and a neighbourhood of about 20 pixels: structure masks errors beside it (Teo and
    Heeger 1994, Perceptual Image Distortion), and errors at edges and in textures are blur or
    aliasing, which PSNR sees. The variance is the product of the halves, without their noise.

    >>> edge = torch.zeros(1, 3, 64, 64)
    >>> edge[..., 32:] = 0.5
    >>> weight = reference_band(edge, edge).weight
    >>> weight[0, 0, 0, 2], weight[0, 0, 0, 32] < 0.01
    (tensor(1.), tensor(True))
    """
    band_a, band_b = filter_band(display_a), filter_band(display_b)
    variance = (band_a * band_b).mean(1, keepdim=True)
    for spacing in (2, 4):
        variance = _smooth(variance, spacing)
    weight = (1 + variance.clamp_min(0) / STRUCTURE**2) ** -2
    return ReferenceBand(band_a, band_b, weight)


def filter_band(image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The image at wavelengths of about 5 to 12 pixels, with unit gain at 7 pixels.

    Power is halved at 4.8 and 11.6 pixels. Beyond the border the image goes on with its last pixel.

    >>> filter_band(torch.ones(1, 1, 8, 8)).abs().max() < 1e-6
    tensor(True)
    """
    fine = _smooth(image, 1)
    return (fine - _smooth(fine, 2)) / PEAK_GAIN


def _smooth(image: Tensor, spacing: int) -> Tensor:
    """Product with the five taps along columns and rows, `spacing` pixels apart."""
    reach = 2 * spacing
    for dim in (2, 3):
        padding = (reach, reach, 0, 0) if dim == 3 else (0, 0, reach, reach)
        padded, length = F.pad(image, padding, mode="replicate"), image.shape[dim]
        at = [padded.narrow(dim, step * spacing, length) for step in range(5)]
        image = TAPS[0] * at[2]  # sums of shifted images: conv2d takes three times as long
        image += TAPS[1] * (at[1] + at[3])
        image += TAPS[2] * (at[0] + at[4])
    return image

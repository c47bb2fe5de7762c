"""Correlations and ratios of noise, with the standard errors that blocks of pixels give."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

BLOCK = 8  # pixels: noise of neighbours inside it may belong together
AROUND = 17  # pixels: surroundings of one
EPS = 1e-2  # of the mean radiance: keeps black pixels from weighing most


def bounded(pool: Float[Tensor, "t s 3 h w"]) -> Float[Tensor, "t s 3 h w"]:
    """The samples as x / (x + mean of the pixel), less the mean of that over the pixel's samples.

    Fireflies count no more than other samples, and samples that are independent stay so given the
    pixel: any two of s then have the correlation -1 / (s - 1), whatever their distribution.
    """
    level = pool.mean(1, keepdim=True) + EPS * pool.mean()
    share = pool / (pool + level).clamp_min(1e-12)
    return share - share.mean(1, keepdim=True)


def correlation(
    one: Float[Tensor, "n 3 h w"], other: Float[Tensor, "n 3 h w"]
) -> tuple[float, float]:
    """Correlation of two noises of mean zero, and its standard error."""
    size = (one.square().sum() * other.square().sum()).sqrt().clamp_min(1e-20)
    parts = _blocks(one * other)
    return float(parts.sum() / size), float(parts.square().sum().sqrt() / size)


def ratio(upper: Float[Tensor, "n 3 h w"], lower: Float[Tensor, "n 3 h w"]) -> tuple[float, float]:
    """Ratio of two sums, and its standard error (delta method)."""
    top, bottom = _blocks(upper), _blocks(lower)
    total = bottom.sum().clamp_min(1e-20)
    quotient = top.sum() / total
    return float(quotient), float((top - quotient * bottom).square().sum().sqrt() / total)


def level(image: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Mean of the surroundings of each pixel, >= 0, and above 0 where the image is not black.

    Noise is told relative to it, and not to the pixel, whose own noise would go into its weight.
    """
    padded = F.pad(image.clamp_min(0), [AROUND // 2] * 4, mode="reflect")
    return F.avg_pool2d(padded, AROUND, 1) + EPS * image.mean().clamp_min(1e-12)


def alike(
    pool: Float[Tensor, "t s 3 h w"], reference: Float[Tensor, "t 3 h w"]
) -> Float[Tensor, "t s 3 h w"]:
    """The samples in the reference's brightness, so that other checks do not depend on it."""
    return pool * (reference.sum() / pool.mean(1).sum().clamp_min(1e-12))


def _blocks(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " blocks"]:
    """Sums over channels and over blocks of BLOCK x BLOCK pixels; those at the edge are smaller."""
    h, w = image.shape[-2:]
    padded = F.pad(image.sum(1, keepdim=True), (0, -w % BLOCK, 0, -h % BLOCK))
    return torch.flatten(F.avg_pool2d(padded, BLOCK) * BLOCK**2).double()

"""Correlations and ratios of noise, with standard errors estimated from blocks of pixels."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

BLOCK = 8  # pixels: noise may be correlated between neighbours within a block
WINDOW = 17  # pixels: side of the neighbourhood of a pixel
EPS = 1e-2  # of the mean radiance: keeps black pixels from dominating


def bounded_noise(pool: Float[Tensor, "t s 3 h w"]) -> Float[Tensor, "t s 3 h w"]:
    """The samples as x / (x + mean of the pixel), minus the mean of that over the pixel's samples.

    Fireflies weigh no more than other samples, and independent samples stay independent given the
    pixel: any two of s then have the correlation -1 / (s - 1), whatever their distribution.
    """
    level = pool.mean(1, keepdim=True) + EPS * pool.mean()
    bounded = pool / (pool + level).clamp_min(1e-12)
    return bounded - bounded.mean(1, keepdim=True)


def correlate(
    one: Float[Tensor, "n 3 h w"], other: Float[Tensor, "n 3 h w"]
) -> tuple[float, float]:
    """Correlation of two noise images with mean zero, and its standard error."""
    norm = (one.square().sum() * other.square().sum()).sqrt().clamp_min(1e-20)
    blocks = _block_sums(one * other)
    return float(blocks.sum() / norm), float(blocks.square().sum().sqrt() / norm)


def ratio_of_sums(
    numerator: Float[Tensor, "n 3 h w"], denominator: Float[Tensor, "n 3 h w"]
) -> tuple[float, float]:
    """Ratio of two sums, and its standard error (delta method)."""
    top, bottom = _block_sums(numerator), _block_sums(denominator)
    total = bottom.sum().clamp_min(1e-20)
    ratio = top.sum() / total
    return float(ratio), float((top - ratio * bottom).square().sum().sqrt() / total)


def local_mean(image: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Mean of the neighbourhood of each pixel, >= 0, and above 0 unless the image is black.

    Noise is measured relative to it rather than to the pixel, whose own noise would bias the
    weight.
    """
    padded = F.pad(image.clamp_min(0), [WINDOW // 2] * 4, mode="reflect")
    return F.avg_pool2d(padded, WINDOW, 1) + EPS * image.mean().clamp_min(1e-12)


def match_brightness(
    pool: Float[Tensor, "t s 3 h w"], reference: Float[Tensor, "t 3 h w"]
) -> Float[Tensor, "t s 3 h w"]:
    """The samples scaled to the reference's mean, so that only one check depends on brightness."""
    return pool * (reference.sum() / pool.mean(1).sum().clamp_min(1e-12))


def _block_sums(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " blocks"]:
    """Sums over channels and blocks of BLOCK x BLOCK pixels; blocks at the edge are smaller."""
    h, w = image.shape[-2:]
    padded = F.pad(image.sum(1, keepdim=True), (0, -w % BLOCK, 0, -h % BLOCK))
    return torch.flatten(F.avg_pool2d(padded, BLOCK) * BLOCK**2).double()

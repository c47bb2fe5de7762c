"""The partitioning pyramid: each pixel's light is split over levels, splatted there, and summed."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.kernels import splat_kernels

__all__ = [
    "DENOISING_TAPS",
    "LEVELS",
    "UPSAMPLING_TAPS",
    "FilterWeights",
    "apply_partitioning_pyramid",
]

LEVELS = 5  # K of the paper: full resolution to 1/16
DENOISING_TAPS = 25  # 5 x 5, from a pixel to pixels of its level
UPSAMPLING_TAPS = 16  # 4 x 4, from a pixel to pixels of the next finer level


class FilterWeights(NamedTuple):
    """The weights of one frame, all >= 0; level i has 1 / 2^i of the resolution."""

    partition: Float[Tensor, "n levels h w"]  # share of each level in a pixel's light, sum 1
    kernels: tuple[Float[Tensor, "n 25 _ _"], ...]  # for each level, sum 1
    upsampling: tuple[Float[Tensor, "n 16 _ _"], ...]  # of levels 1 to 4, sum 4
    history_kernels: Float[Tensor, "n 25 h w"]  # for the previous image, sum 1
    output_history_weight: Float[Tensor, "n 1 h w"]  # mu in (0, 1), of the previous image
    input_history_weight: Float[Tensor, "n 1 h w"]  # lambda in (0, 1), of light and features


def apply_partitioning_pyramid(
    irradiance: Float[Tensor, "n 3 h w"],
    previous: Float[Tensor, "n 3 h w"],
    weights: FilterWeights,
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance split over levels and splatted, blended with the splatted previous image.

    Level i holds the irradiance times its partition weight, averaged over 2^i x 2^i pixels. Every
    pixel of a level spreads its light by its own 5 x 5 kernel. From the coarsest level on, the sum
    is spread to 2 x 2 pixels per pixel by 4 x 4 kernels, and the next finer level is added. The
    result has the weight 1 - mu; the previous image, spread by 5 x 5 kernels, has mu.

    h and w must be multiples of 16. Light is neither lost nor created, except by mu.
    """
    levels = [
        splat_kernels(kernels, _average(irradiance * weights.partition[:, i : i + 1], 2**i))
        for i, kernels in enumerate(weights.kernels)
    ]
    denoised = levels.pop()
    for level, kernels in zip(reversed(levels), reversed(weights.upsampling), strict=True):
        denoised = level + splat_kernels(kernels, denoised, stride=2)
    history = splat_kernels(weights.history_kernels, previous)
    return torch.lerp(denoised, history, weights.output_history_weight)


def _average(image: Tensor, side: int) -> Tensor:
    """The image averaged over tiles of side x side pixels."""
    return F.avg_pool2d(image, side) if side > 1 else image

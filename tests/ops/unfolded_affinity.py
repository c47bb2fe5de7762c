"""A slow version of `rlbench.ops.affinity`: unfolds all windows and stores all weights."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def windows(image: Tensor, side: int, dilation: int) -> Tensor:
    """[n c taps h w] the values in the window of each pixel, zero beyond the border."""
    n, c, h, w = image.shape
    reach = side // 2 * dilation
    return F.unfold(image, side, dilation, reach).view(n, c, side * side, h, w)


def cross_affinity_sum(
    features: Tensor,
    sharpness: Tensor,
    source_features: Tensor,
    source: Tensor,
    side: int,
    dilation: int = 1,
) -> Tensor:
    """As the operation of that name; zeros beyond the border of `source` add nothing."""
    distance = (features[:, :, None] - windows(source_features, side, dilation)).square().sum(1)
    weights = torch.exp(-sharpness * distance)  # n taps h w
    return (weights[:, None] * windows(source, side, dilation)).sum(2)


def affinity_sum(
    features: Tensor, sharpness: Tensor, source: Tensor, side: int, dilation: int = 1
) -> Tensor:
    """As the operation of that name; a pixel has distance zero to itself, so weight 1."""
    return cross_affinity_sum(features, sharpness, features, source, side, dilation) - source

"""The slow twin of `rlbench.ops.affinity`: every window unfolded, every weight in memory."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def windows(image: Tensor, side: int, dilation: int) -> Tensor:
    """[n c taps h w] what lies in the window of each pixel, zero beyond the border."""
    n, c, h, w = image.shape
    reach = side // 2 * dilation
    return F.unfold(image, side, dilation, reach).view(n, c, side * side, h, w)


def alike_in(
    features: Tensor,
    sharpness: Tensor,
    others: Tensor,
    source: Tensor,
    side: int,
    dilation: int = 1,
) -> Tensor:
    """As the op of that name; zeros beyond the border of `source` weigh nothing."""
    distance = (features[:, :, None] - windows(others, side, dilation)).square().sum(1)
    weights = torch.exp(-sharpness * distance)  # n taps h w
    return (weights[:, None] * windows(source, side, dilation)).sum(2)


def alike(
    features: Tensor, sharpness: Tensor, source: Tensor, side: int, dilation: int = 1
) -> Tensor:
    """As the op of that name: a pixel is at distance zero from itself, so it weighs 1."""
    return alike_in(features, sharpness, features, source, side, dilation) - source

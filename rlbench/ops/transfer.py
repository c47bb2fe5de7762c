"""Radiance to a network's range and back, as forward and inverse pairs."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

LOG_SCALE = 64.0  # linear below about 1/64 of display white, logarithmic above: near the sRGB curve
FAR = 1e4  # depth of background once compressed stays finite, scene units


def log_forward(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log(1 + 64 L) / log(65): 0 to 0, display white to 1, above it slowly rising."""
    return torch.log1p(LOG_SCALE * radiance) / math.log1p(LOG_SCALE)


def log_inverse(value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Linear radiance whose `log_forward` is `value`."""
    return torch.expm1(value * math.log1p(LOG_SCALE)) / LOG_SCALE


def squash_depth(depth: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Depth in (0, 1]: 1 / (1 + depth), so 0 for background and 1 at the camera; scale-bound."""
    return 1 / (1 + depth)

"""Radiance to a network's range and back, as forward and inverse pairs."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

LOG_SCALE = 64.0  # linear below about 1/64 of display white, logarithmic above: near the sRGB curve

# the PU curve of OIDN: linear, then a power, then a logarithm, of exposed linear radiance
PU_LINEAR = 1.41283765e03
PU_SCALE, PU_POWER, PU_SHIFT = 1.64593172, 0.431384981, -2.94139609e-03
PU_LOG, PU_KNEE, PU_TOP = 0.192653254, 6.26026094e-03, 0.998620152
PU_RADIANCE = (1.57945760e-06, 3.22087631e-02)  # where the pieces meet
PU_VALUE = (2.23151711e-03, 3.70974749e-01)
HALF_MAX = 65504.0  # the largest half float, mapped to 1
PU_MAX = PU_LOG * math.log(HALF_MAX + PU_KNEE) + PU_TOP


def log_forward(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log(1 + 64 L) / log(65): 0 to 0, display white to 1, above it slowly rising."""
    return torch.log1p(LOG_SCALE * radiance) / math.log1p(LOG_SCALE)


def log_inverse(value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Linear radiance whose `log_forward` is `value`."""
    return torch.expm1(value * math.log1p(LOG_SCALE)) / LOG_SCALE


def pu_forward(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Perceptually uniform value of exposed radiance: 0 to 0, 1 to 0.319, 65504 to 1.

    The fit of Open Image Denoise (Afra 2019) to the PU curve of Aydin et al. 2008. Below zero it
    goes on as a straight line, so that the pair also inverts what a network puts there.
    """
    first, second = PU_RADIANCE
    power = PU_SCALE * radiance.clamp_min(first) ** PU_POWER + PU_SHIFT
    log = PU_LOG * torch.log(radiance.clamp_min(second) + PU_KNEE) + PU_TOP
    value = torch.where(radiance <= first, PU_LINEAR * radiance, power)
    return torch.where(radiance <= second, value, log) / PU_MAX


def pu_inverse(value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Exposed linear radiance whose `pu_forward` is `value`."""
    value = value * PU_MAX
    first, second = PU_VALUE
    power = ((value.clamp_min(first) - PU_SHIFT) / PU_SCALE) ** (1 / PU_POWER)
    exp = torch.exp((value.clamp_min(second) - PU_TOP) / PU_LOG) - PU_KNEE
    radiance = torch.where(value <= first, value / PU_LINEAR, power)
    return torch.where(value <= second, radiance, exp)


def squash_depth(depth: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Depth in [0, 1]: 1 / (1 + depth), so 0 for background and 1 at the camera; scale-bound."""
    return 1 / (1 + depth)

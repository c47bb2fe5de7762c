"""Transfer functions between linear radiance and the range of a network, as inverse pairs."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = [
    "HALF_MAX",
    "LOG_SCALE",
    "log_forward",
    "log_inverse",
    "pu_forward",
    "pu_inverse",
    "squash_depth",
]

LOG_SCALE = 64.0  # linear below about 1/64 of display white, logarithmic above; close to sRGB

# the PU curve of OIDN: linear, then a power, then a logarithm of radiance after exposure
PU_LINEAR = 1.41283765e03
PU_SCALE, PU_POWER, PU_SHIFT = 1.64593172, 0.431384981, -2.94139609e-03
PU_LOG, PU_KNEE, PU_TOP = 0.192653254, 6.26026094e-03, 0.998620152
PU_RADIANCE = (1.57945760e-06, 3.22087631e-02)  # breakpoints between the pieces
PU_VALUE = (2.23151711e-03, 3.70974749e-01)  # values at the breakpoints
HALF_MAX = 65504.0  # the largest half float; PU maps it to 1
PU_MAX = PU_LOG * math.log(HALF_MAX + PU_KNEE) + PU_TOP


def log_forward(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log(1 + 64 L) / log(65) of linear radiance L >= 0: maps 0 to 0 and display white to 1.

    >>> log_forward(torch.tensor([0.0, 1.0])).tolist()
    [0.0, 1.0]
    """
    return torch.log1p(LOG_SCALE * radiance) / math.log1p(LOG_SCALE)


def log_inverse(value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Linear radiance, the inverse of `log_forward`."""
    return torch.expm1(value * math.log1p(LOG_SCALE)) / LOG_SCALE


def pu_forward(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Perceptually uniform (PU) value of radiance after exposure: 0 to 0, 1 to 0.319, 65504 to 1.

    The fit of Open Image Denoise (Afra 2019) to the PU curve of Aydin et al. 2008. Below zero it
    continues as a straight line, so that the pair also inverts negative network outputs.

    >>> round(pu_forward(torch.tensor(1.0)).item(), 3)
    0.319
    """
    first, second = PU_RADIANCE
    power = PU_SCALE * _power(radiance.clamp_min(first), PU_POWER) + PU_SHIFT
    log = PU_LOG * torch.log(radiance.clamp_min(second) + PU_KNEE) + PU_TOP
    value = torch.where(radiance <= first, PU_LINEAR * radiance, power)
    return torch.where(radiance <= second, value, log) / PU_MAX


def pu_inverse(value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Linear radiance after exposure, the inverse of `pu_forward`."""
    value = value * PU_MAX
    first, second = PU_VALUE
    power = _power((value.clamp_min(first) - PU_SHIFT) / PU_SCALE, 1 / PU_POWER)
    exp = torch.exp((value.clamp_min(second) - PU_TOP) / PU_LOG) - PU_KNEE
    radiance = torch.where(value <= first, value / PU_LINEAR, power)
    return torch.where(value <= second, radiance, exp)


def _power(base: Tensor, exponent: float) -> Tensor:
    """A power of a positive base, within some units of its last digit, in 40 % of pow's time."""
    return torch.exp(exponent * base.log())


def squash_depth(depth: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Depth as 1 / (1 + depth), in [0, 1]: 1 at the camera, 0 for background.

    Depends on the unit of length of the scene.
    """
    return 1 / (1 + depth)

"""Albedo demodulation: divide radiance by albedo, so that filters do not blur textures."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

__all__ = [
    "demodulation_albedo",
    "filtered_albedo",
    "reflectance",
    "surface_mask",
]

MIN_REFLECTANCE = 1e-3  # lower bound of albedo in divisions (Falcor's SVGF pass)
ALBEDO_OFFSET = 0.01  # added to albedo before it multiplies a network's output


def reflectance(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Divisor that turns radiance into irradiance (up to a factor of pi), in [0.001, 1].

    `filtered_albedo`, clamped away from zero, as in SVGF (Schied et al. 2017).
    """
    return filtered_albedo(albedo).clamp(MIN_REFLECTANCE, 1)


def filtered_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Albedo averaged over the pixel's area, in [0, 1]; 0 where the pixel's own albedo is black.

    The G-buffer samples albedo at the pixel centre, while radiance covers the whole pixel. The
    average is estimated from the 3 x 3 neighbourhood with binomial weights (1 2 1), without pixels
    whose albedo is black.
    """
    reflects = (albedo > 0).any(1, keepdim=True)
    weighted = torch.cat((albedo.clamp(0, 1), torch.ones_like(albedo[:, :1])), 1) * reflects
    x = F.pad(weighted, (1, 1, 1, 1))  # autocast leaves the sums of slices in float32
    rows = x[..., :-2, :] + 2 * x[..., 1:-1, :] + x[..., 2:, :]
    total = rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]
    return torch.where(reflects, total[:, :3] / total[:, 3:], 0.0)


def demodulation_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Factor from a network's demodulated output to radiance, in [0.01, 1.01].

    albedo + 0.01; where albedo is black, as for emitters and sky, 1.01.

    >>> demodulation_albedo(torch.tensor([0.5, 0.0, 0.25]).view(1, 3, 1, 1)).flatten().tolist()
    [0.5099999904632568, 0.009999999776482582, 0.25999999046325684]
    """
    black = (albedo <= 0).all(1, keepdim=True)
    return torch.where(black, 1.0, albedo) + ALBEDO_OFFSET


def surface_mask(
    albedo: Float[Tensor, "n 3 h w"], depth: Float[Tensor, "n 1 h w"]
) -> Bool[Tensor, "n 1 h w"]:
    """True where a surface reflects light: not for the background, and not where albedo is black.

    Pixels with black albedo show only emitted light.
    """
    return depth.isfinite() & (albedo > 0).any(1, keepdim=True)

"""Light without the texture that reflects it: what filters blur, classical and learned ones."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.transfer import HALF_MAX

DARKEST = 1e-3  # albedo is taken to be at least this (Falcor's SVGF pass)
DARK = 0.01  # added to albedo where a network divides by it


def reflectance(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """What radiance is divided by to give irradiance (up to pi), in [0.001, 1]."""
    return filtered_albedo(albedo).clamp(DARKEST, 1)


def filtered_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Albedo of a pixel's area, in [0, 1]; 0 where the pixel reflects nothing.

    A view has that of the pixel's centre, while light is of all of the pixel. It is estimated as
    the mean of 3x3 pixels, with binomial weights, of those that reflect anything.
    """
    reflects = (albedo > 0).any(1, keepdim=True)
    known = torch.cat((albedo.clamp(0, 1), torch.ones_like(albedo[:, :1])), 1) * reflects
    x = F.pad(known, (1, 1, 1, 1))  # sums of slices, which autocast leaves in float32
    rows = x[..., :-2, :] + 2 * x[..., 1:-1, :] + x[..., 2:, :]
    total = rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]
    return torch.where(reflects, total[:, :3] / total[:, 3:], 0.0)


def demodulation_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """What networks have light multiplied by to give radiance, in [0.01, 1.01].

    That is albedo + 0.01, and 1.01 where albedo is black, as it is for lights and sky.
    """
    black = (albedo <= 0).all(1, keepdim=True)
    return torch.where(black, 1.0, albedo) + DARK


def surface_mask(
    albedo: Float[Tensor, "n 3 h w"], depth: Float[Tensor, "n 1 h w"]
) -> Bool[Tensor, "n 1 h w"]:
    """Where something reflects light: not the background, and not where albedo is black.

    What reflects nothing shows only the light that it emits.
    """
    return depth.isfinite() & (albedo > 0).any(1, keepdim=True)


def sanitize_radiance(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Radiance that can be squared: in [0, 65504], and 0 where a channel is not finite."""
    known = radiance.isfinite().all(-3, keepdim=True)
    return torch.where(known, radiance, 0.0).clamp(0, HALF_MAX)

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
    """What radiance is divided by to give irradiance (up to pi), in [0.001, 1].

    A view has the albedo of a pixel's centre, while its light is spread over the pixel: so it is
    the mean of the pixels around, 3x3 with binomial weights, of those that reflect anything.
    """
    reflects = (albedo > 0).any(1, keepdim=True)
    line = albedo.new_tensor([0.25, 0.5, 0.25])
    kernel = torch.outer(line, line).expand(4, 1, 3, 3)
    known = torch.cat((albedo.clamp(0, 1), reflects.to(albedo.dtype)), 1)
    total = F.conv2d(known * reflects, kernel, padding=1, groups=4)
    return torch.where(reflects, total[:, :3] / total[:, 3:], albedo).clamp(DARKEST, 1)


def raised(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """What networks have light multiplied by to give radiance, in [0.01, 1.01].

    That is albedo + 0.01, and 1.01 where albedo is black, as it is for lights and sky.
    """
    black = (albedo <= 0).all(1, keepdim=True)
    return torch.where(black, 1.0, albedo) + DARK


def surface(
    albedo: Float[Tensor, "n 3 h w"], depth: Float[Tensor, "n 1 h w"]
) -> Bool[Tensor, "n 1 h w"]:
    """Where something reflects light: not the background, and not where albedo is black.

    What reflects nothing shows only the light that it emits.
    """
    return depth.isfinite() & (albedo > 0).any(1, keepdim=True)


def sane(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Radiance that can be squared: in [0, 65504], and 0 where a channel is not finite."""
    known = radiance.isfinite().all(-3, keepdim=True)
    return torch.where(known, radiance, 0.0).clamp(0, HALF_MAX)

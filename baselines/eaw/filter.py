"""The edge-avoiding a-trous filter: passes of growing steps over irradiance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.frames import GBuffer
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps

__all__ = ["Config", "atrous_pass", "filter_irradiance"]

NO_SURFACE = 1e4  # log depth of pixels without a surface: weights to them are exactly 0
ALIGNMENT = 64  # elements: torch sums and exponentiates the last few of others in another way
LOG2E = 1 / math.log(2)  # exp(x) = 2^(LOG2E x)


@dataclass(frozen=True)
class Config:
    """Filter widths: the squared distance at which an edge-stopping weight is 1/e."""

    passes: int = 5  # >= 1
    phi_color: float = 16.0  # of log(1 + irradiance) in the first pass; halved in each further pass
    phi_normal: float = 0.1  # of unit normals, divided by the squared step in pixels
    phi_depth: float = 1e-3  # of log depth


def filter_irradiance(
    config: Config,
    irradiance: Float[Tensor, "n 3 h w"],
    surface: Bool[Tensor, "n 1 h w"],
    gbuffer: GBuffer,
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance after all a-trous passes; pixels that are no surface have no part in it."""
    n, _, h, w = irradiance.shape
    rows = PaddedRows(n, h, w, margin=2**config.passes)
    row = rows.pack(irradiance.where(surface, 0.0))
    normal = rows.pack(gbuffer.normal)
    log_depth = rows.pack(gbuffer.depth.log().where(surface, NO_SURFACE), fill=NO_SURFACE)
    for index in range(config.passes):
        features = _scale_features(config, index, row, normal, log_depth)
        row = atrous_pass(rows, 2**index, features, row)
    return rows.unpack(row)


def _scale_features(
    config: Config, index: int, irradiance: Tensor, normal: Tensor, log_depth: Tensor
) -> Float[Tensor, "7 row"]:
    """Colour, normal and depth, scaled so that a weight is 2^-(squared distance)."""
    color_scale = (LOG2E * 2**index / config.phi_color) ** 0.5
    normal_scale = (LOG2E / config.phi_normal) ** 0.5 / 2**index
    depth_scale = (LOG2E / config.phi_depth) ** 0.5
    return torch.cat(
        (irradiance.log1p() * color_scale, normal * normal_scale, log_depth * depth_scale)
    )


def atrous_pass(
    rows: PaddedRows,
    step: int,
    features: Float[Tensor, "g row"],
    irradiance: Float[Tensor, "c row"],
) -> Float[Tensor, "c row"]:
    """One a-trous pass: mean over 5 x 5 pixels, `step` pixels apart.

    The weight is a B3 spline times 2^-|f_p - f_q|^2 for features f. Weights are symmetric, so each
    is computed once and used for both pixels. Far neighbours come first, and those after a pixel
    are summed apart from those before it: so chunks of the row do not change the order of a sum,
    and a window of an image has the bits of the image.
    """
    values = torch.cat((irradiance, torch.ones_like(irradiance[:1])))
    before, after = torch.zeros_like(values), values.clone()
    for start, stop in rows.chunks(irradiance):
        length = stop - start
        difference = irradiance.new_zeros(len(features), length + -length % ALIGNMENT)
        decay = difference[:1].clone()
        for tap in reversed(atrous_taps(step)):
            shift = rows.offset(tap.down, tap.right)
            p, q = slice(start, stop), slice(start + shift, stop + shift)
            torch.sub(features[:, p], features[:, q], out=difference[:, :length])
            torch.sum(difference.square_(), 0, keepdim=True, out=decay).neg_().exp2_()
            weight = decay[:, :length].mul_(tap.weight)
            after[:, p].addcmul_(values[:, q], weight)
            before[:, q].addcmul_(values[:, p], weight)
    total = before.add_(after)
    return total[:-1] / total[-1:]

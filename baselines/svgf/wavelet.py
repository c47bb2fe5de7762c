"""SVGF's edge-stopping filter: sums over neighbours, weighted by depth, normal and luminance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import Tap

__all__ = ["Edges", "Sums", "atrous_pass"]

SQUARINGS = 7  # the exponent of the cosine between normals is 128 = 2^7


@dataclass(frozen=True)
class Edges:
    """Features that stop the filter, in padded rows; luminance changes between passes."""

    normal: Float[Tensor, "3 row"]  # unit length; zero where there is no surface
    depth: Float[Tensor, "1 row"]  # finite everywhere
    depth_decay: Float[Tensor, "1 row"]  # log2 weight per difference of depth over pixels; <= 0


class Sums(NamedTuple):
    """Sums over a pixel and its neighbours, in padded rows."""

    values: Float[Tensor, "c row"]  # of weight * value
    variance: Float[Tensor, "1 row"]  # of weight^2 * variance
    weight: Float[Tensor, "1 row"]  # of weight, >= 1


def atrous_pass(
    rows: PaddedRows,
    taps: Sequence[Tap],
    edges: Edges,
    luminance_guide: tuple[Float[Tensor, "1 row"], Float[Tensor, "1 row"]],
    values: Float[Tensor, "c row"],
    variance: Float[Tensor, "1 row"],
) -> Sums:
    """Sums over neighbours; the weight from q to p is kernel * w_z * w_n * w_l (Schied 2017, 4.4).

    w_z = 2^(depth_decay_p |z_p - z_q| / |p - q|), w_n = max(0, n_p n_q)^128 and
    w_l = 2^(decay_p |l_p - l_q|), where `luminance_guide` is (l, decay) with decay <= 0.
    Differences are symmetric and computed once for both directions. The weights are powers of 2
    because on a CPU torch's exp takes ten times as long where the result is nearly 0, as most
    weights are.
    """
    sums = Sums(values.clone(), variance.clone(), torch.ones_like(variance))
    for start, stop in rows.chunks(variance):
        scratch = torch.empty(4, stop - start, device=values.device, dtype=values.dtype)
        for tap in taps:
            shift = rows.offset(tap.down, tap.right)
            p, q = slice(start, stop), slice(start + shift, stop + shift)
            _add_pair(p, q, tap, edges, luminance_guide, values, variance, sums, scratch)
    return sums


def _add_pair(
    p: slice,
    q: slice,
    tap: Tap,
    edges: Edges,
    luminance_guide: tuple[Tensor, Tensor],
    values: Tensor,
    variance: Tensor,
    sums: Sums,
    scratch: Float[Tensor, "4 piece"],
) -> None:
    """Add q's contribution to the sums at p, and p's to those at q."""
    w_n, depth_difference, luminance_difference, weight = (scratch[i : i + 1] for i in range(4))
    normal, depth, (luminance, luminance_decay) = edges.normal, edges.depth, luminance_guide
    torch.mul(normal[:1, p], normal[:1, q], out=w_n)
    w_n.addcmul_(normal[1:2, p], normal[1:2, q])
    w_n.addcmul_(normal[2:, p], normal[2:, q]).clamp_min_(0)
    for _ in range(SQUARINGS):
        w_n.mul_(w_n)
    torch.sub(depth[:, p], depth[:, q], out=depth_difference).abs_()
    torch.sub(luminance[:, p], luminance[:, q], out=luminance_difference).abs_()
    inverse_distance = (tap.down**2 + tap.right**2) ** -0.5
    for target, source in ((p, q), (q, p)):
        torch.mul(luminance_difference, luminance_decay[:, target], out=weight)
        weight.addcmul_(depth_difference, edges.depth_decay[:, target], value=inverse_distance)
        weight.exp2_().mul_(w_n)
        sums.values[:, target].addcmul_(values[:, source], weight, value=tap.weight)
        sums.weight[:, target].add_(weight, alpha=tap.weight)
        weight.mul_(weight)
        sums.variance[:, target].addcmul_(variance[:, source], weight, value=tap.weight**2)

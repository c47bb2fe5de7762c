"""Averages over neighbours that edges of depth, normal and luminance stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import Tap

SQUARINGS = 7  # cosines enter with the power 128 = 2^7


@dataclass(frozen=True)
class Edges:
    """What stops a filter, in a row: all of it but luminance, which changes from pass to pass."""

    normal: Float[Tensor, "3 row"]  # unit length; zero where there is no surface
    depth: Float[Tensor, "1 row"]  # finite everywhere
    decay: Float[Tensor, "1 row"]  # of the weight, in powers of 2 by depth over pixels; <= 0


class Sums(NamedTuple):
    """Over a pixel and its neighbours, in a row."""

    values: Float[Tensor, "c row"]  # of weight * value
    variance: Float[Tensor, "1 row"]  # of weight^2 * variance
    weight: Float[Tensor, "1 row"]  # of weight, >= 1


def atrous_pass(
    flat: PaddedRows,
    taps: Sequence[Tap],
    edges: Edges,
    light: tuple[Float[Tensor, "1 row"], Float[Tensor, "1 row"]],
    values: Float[Tensor, "c row"],
    variance: Float[Tensor, "1 row"],
) -> Sums:
    """Sums over neighbours; the weight from q to p is kernel * w_z * w_n * w_l (Schied 2017, 4.4).

    w_z = 2^(decay_p |z_p - z_q| / |p - q|), w_n = max(0, n_p n_q)^128 and w_l = 2^(keen_p
    |l_p - l_q|), with `light` = (l, keen), keen <= 0. What two neighbours are to each other but for
    decay and keen is the same both ways, and computed once. Powers of 2 since on a CPU torch takes
    ten times as long for exp where the result is all but 0, which most weights are.
    """
    sums = Sums(values.clone(), variance.clone(), torch.ones_like(variance))
    for start, stop in flat.chunks(variance):
        scratch = torch.empty(4, stop - start, device=values.device, dtype=values.dtype)
        for tap in taps:
            away = flat.offset(tap.down, tap.right)
            here, there = slice(start, stop), slice(start + away, stop + away)
            _exchange(here, there, tap, edges, light, values, variance, sums, scratch)
    return sums


def _exchange(
    here: slice,
    there: slice,
    tap: Tap,
    edges: Edges,
    light: tuple[Tensor, Tensor],
    values: Tensor,
    variance: Tensor,
    sums: Sums,
    scratch: Float[Tensor, "4 piece"],
) -> None:
    """Add to each of two slices what the other has for it."""
    alike, depths, lights, weight = (scratch[i : i + 1] for i in range(4))
    normal, depth, (bright, keen) = edges.normal, edges.depth, light
    torch.mul(normal[:1, here], normal[:1, there], out=alike)
    alike.addcmul_(normal[1:2, here], normal[1:2, there])
    alike.addcmul_(normal[2:, here], normal[2:, there]).clamp_min_(0)
    for _ in range(SQUARINGS):
        alike.mul_(alike)
    torch.sub(depth[:, here], depth[:, there], out=depths).abs_()
    torch.sub(bright[:, here], bright[:, there], out=lights).abs_()
    near = (tap.down**2 + tap.right**2) ** -0.5
    for to, source in ((here, there), (there, here)):
        torch.mul(lights, keen[:, to], out=weight)
        weight.addcmul_(depths, edges.decay[:, to], value=near).exp2_().mul_(alike)
        sums.values[:, to].addcmul_(values[:, source], weight, value=tap.weight)
        sums.weight[:, to].add_(weight, alpha=tap.weight)
        weight.mul_(weight)
        sums.variance[:, to].addcmul_(variance[:, source], weight, value=tap.weight**2)

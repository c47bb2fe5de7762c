"""What was remembered of a surface, found again through motion, and the mean with this frame."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.ops.padded_rows import PaddedRows

NEARER = 0.1  # two depths of one surface differ by at most this share (RTXDI, Q2RTX)
ALIGNED = 0.9  # and the cosine between its normals is at least this (ours, after ReSTIR's tests)
ENOUGH = 0.01  # total weight below which bilinear taps do not count as found (Falcor)
LONGEST = 32.0  # frames that a history is said to be long at most (Falcor)
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB

BILINEAR = [(y, x) for y in (0, 1) for x in (0, 1)]
AROUND = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)]


class History(NamedTuple):
    """What is remembered, in a row (see `Flat`); a length of 0 means nothing."""

    mean: Float[Tensor, "6 row"]  # irradiance filtered once, luminance, its square, length
    depth: Float[Tensor, "1 row"]
    normal: Float[Tensor, "3 row"]


class TemporalMoments(NamedTuple):
    """Exponential means over the frames of a history, as images."""

    light: Float[Tensor, "n 3 h w"]  # irradiance
    moments: Float[Tensor, "n 2 h w"]  # luminance and its square
    length: Float[Tensor, "n 1 h w"]  # frames, 0 where there is no surface

    @property
    def variance(self) -> Float[Tensor, "n 1 h w"]:
        """Of luminance, over time."""
        return (self.moments[:, 1:] - self.moments[:, :1].square()).clamp_min(0)


def nothing(flat: PaddedRows, device: torch.device) -> History:
    """The memory before the first frame."""
    empty = flat.pack(torch.zeros(flat.n, 10, flat.h, flat.w, device=device))
    return History(empty[:6], empty[6:7], empty[7:])


def luminance(light: Float[Tensor, "n 3 *size"]) -> Float[Tensor, "n 1 *size"]:
    """Relative luminance of linear sRGB."""
    red, green, blue = LUMINANCE
    return red * light[:, :1] + green * light[:, 1:2] + blue * light[:, 2:]


def reproject_history(
    flat: PaddedRows,
    past: History,
    motion: Float[Tensor, "n 2 h w"] | None,
    depth: Float[Tensor, "n 1 h w"],
    normal: Float[Tensor, "n 3 h w"],
) -> Float[Tensor, "n 6 h w"]:
    """`past.mean` as seen from this frame; zero, length included, where nothing is found.

    Of the four pixels around the earlier position those count that show the same surface; if none
    does, those of nine do. `motion` None means that nothing moved, and nothing is searched.
    """
    if motion is None:
        return flat.unpack(past.mean)
    x, y = (_position(motion, axis) for axis in (0, 1))
    x0, y0 = x.floor(), y.floor()
    right, down = x - x0, y - y0
    weights = [wy * wx for wy in (1 - down, down) for wx in (1 - right, right)]
    surface = (depth.reshape(-1), normal.transpose(0, 1).reshape(3, -1))
    place = flat.pixel_index(x0, y0).view(-1)
    found, total = _tapped(flat, past, place, BILINEAR, [w.view(-1) for w in weights], surface)

    lost = ((total < ENOUGH) & (surface[1] != 0).any(0)).nonzero()[:, 0]
    near = flat.pixel_index((x + 0.5).floor(), (y + 0.5).floor()).view(-1)[lost]
    again = (surface[0][lost], surface[1][:, lost])
    equal = [torch.ones_like(again[0])] * len(AROUND)
    refound, retotal = _tapped(flat, past, near, AROUND, equal, again)
    found[:, lost], total[lost] = refound, retotal
    mean = torch.where(total >= ENOUGH, found / total, 0.0)
    return mean.view(6, flat.n, flat.h, flat.w).transpose(0, 1)


def accumulate(
    light: Float[Tensor, "n 3 h w"],
    known: Tensor,
    past: Float[Tensor, "n 6 h w"],
    keep: tuple[float, float],
) -> TemporalMoments:
    """This frame's irradiance averaged into the past, whose weight is at most 1 - `keep`.

    `keep` is the least weight of this frame in colour and in moments; while the history is
    short all its frames weigh the same. Where `known` is false this frame says nothing.
    """
    old_light, old_moments, old_length = past[:, :3], past[:, 3:5], past[:, 5:]
    length = (old_length + 1).clamp_max(LONGEST)
    told = known | (old_length == 0)
    of_light, of_moments = (torch.where(told, (1 / length).clamp_min(k), 0.0) for k in keep)
    bright = luminance(light)
    moments = torch.cat((bright, bright.square()), 1)
    return TemporalMoments(
        torch.lerp(old_light, light, of_light),
        torch.lerp(old_moments, moments, of_moments),
        length,
    )


def _position(motion: Tensor, axis: int) -> Float[Tensor, "n h w"]:
    """Where each pixel was, in pixels right (axis 0) or down (axis 1); far outside if unknown."""
    pixels = torch.arange(motion.shape[3 - axis], device=motion.device, dtype=motion.dtype)
    here = pixels if axis == 0 else pixels[:, None]
    return (here + motion[:, axis]).nan_to_num(-1e6, 1e6, -1e6)


def _tapped(
    flat: PaddedRows,
    past: History,
    place: Int[Tensor, " m"],
    taps: list[tuple[int, int]],
    weights: list[Float[Tensor, " m"]],
    surface: tuple[Float[Tensor, " m"], Float[Tensor, "3 m"]],
) -> tuple[Float[Tensor, "6 m"], Float[Tensor, " m"]]:
    """Weighted sum of the taps that show the same surface, and the sum of their weights."""
    depth, normal = surface
    found, total = place.new_zeros(6, len(place), dtype=depth.dtype), torch.zeros_like(depth)
    for tap, weight in zip(taps, weights, strict=True):
        there = place + flat.offset(*tap)
        mean = past.mean.index_select(1, there)
        apart = (past.depth[0].take(there) - depth).abs()
        along = (past.normal.index_select(1, there) * normal).sum(0)
        same = (mean[5] > 0) & (apart <= NEARER * depth) & (along >= ALIGNED)
        counted = weight * same
        found.addcmul_(mean, counted)
        total += counted
    return found, total

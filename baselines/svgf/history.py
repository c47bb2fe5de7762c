"""SVGF's temporal part: reproject the history with surface tests, and accumulate this frame."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.ops.asking import may_ask
from rlbench.ops.color import REC709_LUMINANCE
from rlbench.ops.padded_rows import PaddedRows

MAX_DEPTH_DIFFERENCE = 0.1  # relative, between two views of one surface (RTXDI, Q2RTX)
MIN_NORMAL_COSINE = 0.9  # between its normals (ours, after ReSTIR's tests)
MIN_WEIGHT = 0.01  # total weight below which the bilinear taps are rejected (Falcor)
MAX_HISTORY_LENGTH = 32.0  # frames (Falcor)

BILINEAR_TAPS = [(y, x) for y in (0, 1) for x in (0, 1)]
BOX_TAPS = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)]


class History(NamedTuple):
    """The state between frames, in padded rows (see `PaddedRows`); length 0 means no history."""

    accumulated: Float[Tensor, "6 row"]  # irradiance of the feedback tap, two moments, length
    depth: Float[Tensor, "1 row"]
    normal: Float[Tensor, "3 row"]


class TemporalMoments(NamedTuple):
    """Exponential moving averages over the frames of a history, as images."""

    irradiance: Float[Tensor, "n 3 h w"]
    moments: Float[Tensor, "n 2 h w"]  # luminance and its square
    length: Float[Tensor, "n 1 h w"]  # history length in frames

    @property
    def variance(self) -> Float[Tensor, "n 1 h w"]:
        """Temporal variance of luminance."""
        return (self.moments[:, 1:] - self.moments[:, :1].square()).clamp_min(0)


def empty_history(rows: PaddedRows, device: torch.device) -> History:
    """The state before the first frame."""
    zeros = rows.pack(torch.zeros(rows.n, 10, rows.h, rows.w, device=device))
    return History(zeros[:6], zeros[6:7], zeros[7:])


def luminance(irradiance: Float[Tensor, "n 3 *size"]) -> Float[Tensor, "n 1 *size"]:
    """Rec. 709 luminance.

    Not `rlbench.ops.color.luminance`: rows have no height, and this order of sums is kept so that
    images stay bit-identical.
    """
    red, green, blue = REC709_LUMINANCE
    return red * irradiance[:, :1] + green * irradiance[:, 1:2] + blue * irradiance[:, 2:]


def reproject_history(
    rows: PaddedRows,
    history: History,
    motion: Float[Tensor, "n 2 h w"] | None,
    depth: Float[Tensor, "n 1 h w"],
    normal: Float[Tensor, "n 3 h w"],
) -> Float[Tensor, "n 6 h w"]:
    """`history.accumulated` as seen from this frame; zero, length included, where disoccluded.

    Of the four bilinear taps around the previous position those on the same surface count; if none
    does, those of a 3 x 3 box count. `motion` None means a static frame: every pixel keeps its own
    history without a surface test.
    """
    history = history._replace(accumulated=_drop_nonfinite(history.accumulated))
    if motion is None:
        return rows.unpack(history.accumulated)
    x, y = (_previous_position(motion, axis) for axis in (0, 1))
    x0, y0 = x.floor(), y.floor()
    right, down = x - x0, y - y0
    bilinear = [(wy * wx).view(-1) for wy in (1 - down, down) for wx in (1 - right, right)]
    surface = (depth.reshape(-1), normal.transpose(0, 1).reshape(3, -1))
    corner = rows.pixel_index(x0, y0).view(-1)
    total, weight = _sum_matching_taps(rows, history, corner, BILINEAR_TAPS, bilinear, surface)

    # pixels without a bilinear tap: 3 x 3 box
    missing = (weight < MIN_WEIGHT) & (surface[1] != 0).any(0)
    nearest = rows.pixel_index((x + 0.5).floor(), (y + 0.5).floor()).view(-1)
    asks = may_ask(missing)
    if asks:
        missing = missing.nonzero()[:, 0]
        nearest, surface = nearest[missing], (surface[0][missing], surface[1][:, missing])
    ones = [torch.ones_like(surface[0])] * len(BOX_TAPS)
    box_total, box_weight = _sum_matching_taps(rows, history, nearest, BOX_TAPS, ones, surface)
    if asks:
        total[:, missing], weight[missing] = box_total, box_weight
    else:
        total, weight = box_total.where(missing, total), box_weight.where(missing, weight)
    mean = torch.where(weight >= MIN_WEIGHT, total / weight, 0.0)
    return mean.view(6, rows.n, rows.h, rows.w).transpose(0, 1)


def accumulate(
    irradiance: Float[Tensor, "n 3 h w"],
    finite: Tensor,
    history: Float[Tensor, "n 6 h w"],
    alphas: tuple[float, float],
) -> TemporalMoments:
    """Blend this frame into the reprojected history: C = alpha C_now + (1 - alpha) C_history.

    alpha is max(alphas, 1 / length), so the frames of a short history weigh the same; `alphas` are
    (alpha_color, alpha_moments). Where `finite` is false and there is history, alpha is 0.
    """
    old_irradiance, old_moments, old_length = history[:, :3], history[:, 3:5], history[:, 5:]
    length = (old_length + 1).clamp_max(MAX_HISTORY_LENGTH)
    is_used = finite | (old_length == 0)
    alpha_color, alpha_moments = (
        torch.where(is_used, (1 / length).clamp_min(alpha), 0.0) for alpha in alphas
    )
    first_moment = luminance(irradiance)
    moments = torch.cat((first_moment, first_moment.square()), 1)
    return TemporalMoments(
        torch.lerp(old_irradiance, irradiance, alpha_color),
        torch.lerp(old_moments, moments, alpha_moments),
        length,
    )


def _drop_nonfinite(accumulated: Float[Tensor, "6 row"]) -> Float[Tensor, "6 row"]:
    """Zero, length included, at pixels with a value that is not finite."""
    return accumulated.where(accumulated.isfinite().all(0), 0.0)


def _previous_position(motion: Tensor, axis: int) -> Float[Tensor, "n h w"]:
    """Each pixel's x (axis 0) or y (axis 1) in the previous frame; far outside if not finite."""
    pixels = torch.arange(motion.shape[3 - axis], device=motion.device, dtype=motion.dtype)
    current = pixels if axis == 0 else pixels[:, None]
    return (current + motion[:, axis]).nan_to_num(-1e6, 1e6, -1e6)


def _sum_matching_taps(
    rows: PaddedRows,
    history: History,
    place: Int[Tensor, " m"],
    taps: list[tuple[int, int]],
    weights: list[Float[Tensor, " m"]],
    surface: tuple[Float[Tensor, " m"], Float[Tensor, "3 m"]],
) -> tuple[Float[Tensor, "6 m"], Float[Tensor, " m"]]:
    """Weighted sum of the taps on the same surface (depth, normal), and the sum of weights."""
    depth, normal = surface
    total, total_weight = place.new_zeros(6, len(place), dtype=depth.dtype), torch.zeros_like(depth)
    for tap, weight in zip(taps, weights, strict=True):
        tap_place = place + rows.offset(*tap)
        accumulated = history.accumulated.index_select(1, tap_place)
        depth_difference = (history.depth[0].take(tap_place) - depth).abs()
        cosine = (history.normal.index_select(1, tap_place) * normal).sum(0)
        matches = (
            (accumulated[5] > 0)
            & (depth_difference <= MAX_DEPTH_DIFFERENCE * depth)
            & (cosine >= MIN_NORMAL_COSINE)
        )
        matching_weight = weight * matches
        total.addcmul_(accumulated, matching_weight)
        total_weight += matching_weight
    return total, total_weight

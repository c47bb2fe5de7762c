"""Errors that change from frame to frame: what a viewer sees as flicker, boiling and ghosts.

A display error is image minus reference in clipped sRGB, NaN in pixels that are not finite
(`Comparison.display_error`). A surface that keeps its error looks steady; these metrics measure the
rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from metrics.psnr import decibels

__all__ = [
    "ErrorChange",
    "PreviousPositions",
    "change_of_error",
    "flicker",
    "locate_previous",
    "tpsnr",
    "warp",
    "warped_error",
]

WORST_CHANGE = 2.0  # of a display error, in [-1, 1], from one frame to the next
WORST_SECOND_CHANGE = 4.0  # between two such changes
FLICKER_GAIN = math.sqrt(6)  # of the taps 1, -2, 1 on white noise
MIN_WEIGHT = 1e-3  # of a bilinear tap that counts as read; smaller ones are rounding


class PreviousPositions(NamedTuple):
    """Where the pixels of a frame were in the previous one."""

    grid: Float[Tensor, "n h w 2"] | None  # as F.grid_sample takes it; None: nothing moves
    is_inside: Bool[Tensor, "n 1 h w"]  # the pixel's motion leads into the previous image


class ErrorChange(NamedTuple):
    """Change of the display error of a surface since the previous frame."""

    change: Float[Tensor, "n 3 h w"]  # in [-2, 2]; NaN where either frame is not finite
    positions: PreviousPositions


def tpsnr(
    error: Float[Tensor, "n 3 h w"], previous_error: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Temporal PSNR in dB, in [-6, 100]: PSNR of the change between two frames; higher is better.

    -10 log10 of the mean squared difference between the image's change and the reference's change,
    both in clipped sRGB, peak 1, which is the change of the display error. A flickering image
    scores low; an error that stays the same in both frames does not count, as in the temporal loss
    of Chaitanya et al. 2017. A pixel that is not finite in either frame has the largest change, 2
    in every channel.

    Frames are not reprojected by motion vectors, as those of `warped_error` are, and the noise of
    the reference counts twice. Temporal blur lowers the PSNR of the frames, not this score.

    >>> right = torch.zeros(1, 3, 8, 8)
    >>> wrong = right + 0.5
    >>> tpsnr(wrong, wrong), tpsnr(wrong, right)  # without flicker, and with it
    (tensor([100.]), tensor([6.0206]))
    """
    change = (error - previous_error).square().nan_to_num(nan=WORST_CHANGE**2)
    return decibels(change.flatten(1).mean(1, dtype=torch.float64))


def change_of_error(
    error: Float[Tensor, "n 3 h w"],
    previous_error: Float[Tensor, "n 3 h w"],
    positions: PreviousPositions,
) -> ErrorChange:
    """The display error less that of the previous frame, moved along the motion (see `warp`).

    Because warping is linear, this is the image's change along the motion less the reference's own:
    shading that really changes is no error. Where the motion leaves the image, the change is 0.

    >>> error = torch.zeros(1, 3, 1, 4)
    >>> error[..., 1] = 0.5
    >>> moved_left = torch.ones(1, 1, 1, 4) * torch.tensor([1.0, 0.0]).view(1, 2, 1, 1)
    >>> positions = locate_previous(error, moved_left)
    >>> change_of_error(error.roll(-1, 3), error, positions).change.abs().max()
    tensor(0.)
    """
    moved = _read_keeping_nan(previous_error, positions)
    return ErrorChange(torch.where(positions.is_inside, error - moved, 0.0 * error), positions)


def warped_error(step: ErrorChange) -> Float[Tensor, " n"]:
    """Warped temporal error in percent of the display's range, in [0, 200]; lower is better.

    The root mean square, over pixels and channels, of the image's change along the motion less the
    reference's own change, in clipped sRGB. Lai et al. 2018, Learning Blind Video Temporal
    Consistency, section 4.2, take the image's change alone; here what the reference does too is
    free. An error that moves with its surface scores 0, and so does an image that is moved as the
    motion says. Pixels whose motion leaves the image are left out; NaN if that is all, as at a cut.
    A pixel that is not finite in either frame has the largest change, 2.

    Differs: pixels that were hidden in the previous frame, but whose motion ends inside it, count,
    because motion alone does not tell them; their reference changes as the image does. The noise of
    the reference counts twice, and bilinear taps lower that of the previous frame.

    >>> error = torch.zeros(1, 3, 8, 8)
    >>> warped_error(change_of_error(error + 0.1, error, locate_previous(error, motion=None)))
    tensor([10.])
    """
    return 100 * _root_mean_square(step.change, step.positions.is_inside, WORST_CHANGE)


def flicker(step: ErrorChange, previous_step: ErrorChange) -> Float[Tensor, " n"]:
    """Flicker in percent of the display's range, in [0, 163]; lower is better.

    The part of the display error that changes back and forth: with e0, e1, e2 the errors of one
    surface in three successive frames, the root mean square of e0 - 2 e1 + e2 over pixels and
    channels, divided by sqrt(6). This filter has no gain at a constant error or a steady drift, and
    its largest at half the frame rate: a ghost that fades evenly is no flicker, though it is warped
    error. Errors that are independent from frame to frame score their own standard deviation. The
    filter is the second difference in time; definition and scale are ours.

    `step` and `previous_step` are the changes of the last two frames. Pixels whose motion leaves
    the image in either are left out; NaN if that is all. A pixel that is not finite in one of the
    three frames has the largest value, 4 / sqrt(6).

    >>> error = [torch.full((1, 3, 8, 8), value) for value in (0.1, 0.2, 0.3, 0.0)]
    >>> static = locate_previous(error[0], motion=None)
    >>> steps = [change_of_error(b, a, static) for a, b in zip(error, error[1:])]
    >>> drift, reversal = flicker(steps[1], steps[0]), flicker(steps[2], steps[1])
    >>> drift.round(decimals=4), reversal.round(decimals=4)  # |0.2 - 2 * 0.3 + 0.0| / sqrt(6)
    (tensor([0.]), tensor([16.3299]))
    """
    moved = _read_keeping_nan(previous_step.change, step.positions)
    was_outside = _read((~previous_step.positions.is_inside).to(moved.dtype), step.positions)
    is_inside = step.positions.is_inside & (was_outside <= MIN_WEIGHT)
    second = torch.where(is_inside, step.change - moved, 0.0 * step.change)
    return 100 / FLICKER_GAIN * _root_mean_square(second, is_inside, WORST_SECOND_CHANGE)


def warp(
    values: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n c h w"], Bool[Tensor, "n 1 h w"]]:
    """Values of the previous frame at the pixels of this one, bilinear, and where they are inside.

    `motion` is in pixels, from a pixel to its position in the previous frame, x right and y down;
    None means that nothing moves. Pixels whose motion leaves the image, or is not finite, have
    values of the border or of the corner. `rlbench.ops.reproject` does the same for methods; it is
    repeated here because metrics import nothing from rlbench.

    >>> right = torch.tensor([0.5, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 3)
    >>> moved, is_inside = warp(torch.tensor([[[[0.0, 2.0, 4.0]]]]), right)
    >>> moved.flatten().tolist(), is_inside.flatten().tolist()
    ([1.0, 3.0, 4.0], [True, True, False])
    """
    positions = locate_previous(values, motion)
    return _read(values, positions), positions.is_inside


def locate_previous(
    like: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> PreviousPositions:
    """Where the pixels of an image were in the previous frame; `like` gives its size.

    >>> left = torch.tensor([-1.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 3)
    >>> locate_previous(torch.zeros(1, 3, 1, 3), left).is_inside.flatten().tolist()
    [False, True, True]
    """
    h, w = like.shape[-2:]
    if motion is None:
        return PreviousPositions(None, like.new_ones(like[:, :1].shape, dtype=torch.bool))
    x = torch.arange(w, device=motion.device, dtype=motion.dtype) + motion[:, 0]
    y = torch.arange(h, device=motion.device, dtype=motion.dtype)[:, None] + motion[:, 1]
    is_inside = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), -1).nan_to_num(nan=-1.0)
    return PreviousPositions(grid, is_inside[:, None])


def _read(values: Tensor, positions: PreviousPositions) -> Tensor:
    """Values of the previous frame, bilinear; beyond the image those of its border."""
    if positions.grid is None:
        return values
    return F.grid_sample(
        values, positions.grid, "bilinear", padding_mode="border", align_corners=False
    )


def _read_keeping_nan(values: Tensor, positions: PreviousPositions) -> Tensor:
    """As `_read`; a value that reads a NaN is NaN, one beside a NaN is not."""
    if not _has_nan(values):
        return _read(values, positions)
    is_nan = values.isnan().any(1, keepdim=True)
    both = torch.cat((values.nan_to_num(nan=0.0), is_nan.to(values.dtype)), 1)
    moved = _read(both, positions)
    return moved[:, :-1].masked_fill(moved[:, -1:] > MIN_WEIGHT, math.nan)


def _has_nan(values: Tensor) -> bool:
    """True if a value is NaN; no value is infinite."""
    return bool(values.sum().isnan())


def _root_mean_square(change: Tensor, is_inside: Tensor, worst: float) -> Tensor:
    """Over pixels inside and, with the `worst` value, those that are not finite; NaN if none."""
    squares, counted = change.square(), is_inside
    if _has_nan(change):
        is_nan = change.isnan().any(1, keepdim=True)
        squares, counted = squares.masked_fill(is_nan, worst**2), counted | is_nan
    squares = squares.mean(1, keepdim=True).double()
    mean = (squares * counted).flatten(1).sum(1) / counted.flatten(1).sum(1).clamp_min(1)
    has_history = is_inside.flatten(1).any(1)
    return mean.sqrt().where(has_history, math.nan).float()

"""Temporal reprojection: warp the history to the current frame by motion vectors."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.asking import may_ask

__all__ = ["ReprojectionMemo", "reproject", "reproject_bicubic", "reproject_or_fill"]

MAX_STRIPS = 8  # that one image is cut into; a power of two

G = TypeVar("G")  # G-buffer
S = TypeVar("S")  # state
H = TypeVar("H")  # history


def reproject(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n c h w"], Bool[Tensor, "n 1 h w"]]:
    """The history warped to the current frame with bilinear taps, and a mask of valid pixels.

    `motion` is in pixels, from a pixel to its position in the previous frame, x right and y down;
    None means no motion, and the history is returned unchanged. A pixel is valid if all taps of
    non-zero weight lie inside the image; motion that is not finite is invalid. Disocclusion inside
    the image is not tested. Invalid pixels hold arbitrary values, see `reproject_or_fill`.

    >>> history = torch.tensor([1.0, 2.0, 3.0]).view(1, 1, 1, 3)
    >>> to_the_right = torch.tensor([1.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 3)
    >>> warped, valid = reproject(history, to_the_right)
    >>> valid.flatten().tolist()
    [True, True, False]
    """
    if motion is None:
        return history, _all_valid(history)
    x, y, valid = _previous_position(motion)
    return _sample(history, x, y, "bilinear"), valid


def reproject_bicubic(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n c h w"], Bool[Tensor, "n 1 h w"]]:
    """As `reproject`, with bicubic taps: repeated reprojection blurs the history less.

    Temporal antialiasing filters use the Catmull-Rom kernel (Yang, Liu and Salvi 2020, A Survey of
    Temporal Antialiasing Techniques). Differs: the kernel is torch's, that of Keys 1981 with
    a = -0.75. Values are clamped to the range of the four bilinear taps, so that bright pixels
    cause no ringing.
    """
    if motion is None:
        return history, _all_valid(history)
    x, y, valid = _previous_position(motion)
    padded = F.pad(history, (0, 1, 0, 1), mode="replicate")
    # both bounds are images of one batch, which grid_sample computes side by side
    bounds = torch.cat((_reduce_2x2(torch.maximum, padded), _reduce_2x2(torch.minimum, padded)))
    left, top = (each.floor().repeat(2, 1, 1) for each in (x, y))
    largest, least = _sample(bounds, left, top, "nearest").chunk(2)
    return _sample(history, x, y, "bicubic").clamp(least, largest), valid


def reproject_or_fill(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None, fill_value: float
) -> Float[Tensor, "n c h w"]:
    """The history warped to the current frame by `reproject`; invalid pixels get `fill_value`."""
    warped, valid = reproject(history, motion)
    return warped.where(valid, fill_value)


def _reduce_2x2(reduce: Callable[[Tensor, Tensor], Tensor], values: Tensor) -> Tensor:
    """Maximum or minimum of each value and its neighbours right and below.

    Takes a 60th of the time of max_pool2d.
    """
    columns = reduce(values[..., :-1], values[..., 1:])
    return reduce(columns[..., :-1, :], columns[..., 1:, :])


def _all_valid(history: Tensor) -> Tensor:
    n, _, h, w = history.shape
    return torch.ones(n, 1, h, w, dtype=torch.bool, device=history.device)


def _previous_position(motion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Previous position of each pixel, x and y [n h w], and whether it is inside [n 1 h w]."""
    h, w = motion.shape[-2:]
    x = torch.arange(w, device=motion.device, dtype=motion.dtype) + motion[:, 0]
    y = torch.arange(h, device=motion.device, dtype=motion.dtype)[:, None] + motion[:, 1]
    valid = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)  # false for NaN
    return torch.where(valid, x, 0.0), torch.where(valid, y, 0.0), valid[:, None]


def _sample(history: Tensor, x: Tensor, y: Tensor, mode: str) -> Tensor:
    """The history at pixel positions, interpolated by `mode` of torch's grid_sample."""
    h, w = history.shape[-2:]
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), dim=-1)
    dtype = torch.promote_types(history.dtype, grid.dtype)  # half floats cannot index all pixels
    values, grid = history.to(dtype), grid.to(dtype)
    strips = math.gcd(h, MAX_STRIPS) if len(history) == 1 and _uses_threads(values) else 1
    warped = F.grid_sample(
        values.expand(strips, -1, -1, -1) if strips > 1 else values,
        grid.view(-1, h // strips, w, 2),
        mode,
        padding_mode="border",
        align_corners=False,
    )
    if strips > 1:
        warped = warped.transpose(0, 1).reshape(values.shape)
    return warped.to(history.dtype)


def _uses_threads(values: Tensor) -> bool:
    """On a processor, grid_sample computes one image on one core; cut into strips, it uses all.

    On one thread, strips only make the backward pass sum a gradient for each of them.
    """
    return may_ask(values) and torch.get_num_threads() > 1


class ReprojectionMemo(Generic[H]):
    """The most recent reprojection, so that `plan` and `denoise` of one frame share it.

    The key is the identity of G-buffer and state. Both are referenced weakly, so the memo keeps no
    input alive; it holds one history at most, until the next frame. It changes no result, only the
    time: reprojection takes about a tenth of a frame. With gradients enabled, or compiled, every
    call computes, because it needs a graph of its own.
    """

    def __init__(self) -> None:
        """An empty memo."""
        self._key: tuple[weakref.ref[object], weakref.ref[object]] | None = None

    def get(self, gbuffer: G, state: S, compute: Callable[[G, S], H]) -> H:
        """compute(gbuffer, state), or its last result if both arguments are the same objects."""
        if torch.is_grad_enabled() or torch.compiler.is_compiling():
            return compute(gbuffer, state)
        if self._key is None or self._key[0]() is not gbuffer or self._key[1]() is not state:
            self._history = compute(gbuffer, state)
            self._key = (weakref.ref(gbuffer), weakref.ref(state))
        return self._history

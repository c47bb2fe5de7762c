"""Images to rows of the results table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.results import Row
from rlbench.run import FrameResult


def _with(before: FrameResult, images: Sequence[Tensor]) -> list[Tensor]:
    """Image and halves of the reference, each with that of the frame before: [n 2 3 h w]."""
    earlier = (before.image, before.frame.reference.half_a, before.frame.reference.half_b)
    return [torch.stack(pair, 1) for pair in zip(earlier, images, strict=True)]


def _row(
    blank: Row, metric: str, value: float, unit: str, better: str, how: str, note: str = ""
) -> Row:
    """A number; one that is not finite is no number, and the note says so."""
    if not math.isfinite(value):
        note, value = note or f"the value is {value}", math.nan
    return replace(
        blank, metric=metric, value=value, unit=unit, better=better, convention=how, note=note
    )


def _check(method: str, image: Tensor, like: Tensor) -> None:
    """Raise PluginError for an image that metrics would broadcast or round without a word."""
    if image.shape != like.shape or image.dtype != like.dtype:
        raise registry.PluginError(
            f"'{method}' returned an image of {image.dtype} {list(image.shape)}, "
            f"wanted {like.dtype} {list(like.shape)}"
        )

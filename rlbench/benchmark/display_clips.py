"""Clips as a display shows them, for videos: kept images and references in clipped sRGB."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float16, UInt8
from numpy import ndarray as Array

from rlbench.benchmark.image_sheet import LinearImage
from rlbench.benchmark.shown_clips import ShownClip, ShownImages

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DisplayClip", "DisplayImages", "display_clips"]


@dataclass(frozen=True)
class DisplayImages:
    """The output of one method on all frames of a clip."""

    name: str  # of the rows
    frames: UInt8[Array, "t h w 3"]  # clipped sRGB; pixels that are not finite are magenta
    counts: Float16[Array, "t h w"]  # samples of each pixel
    psnr: tuple[float, ...]  # dB of each frame; NaN where the results have none


@dataclass(frozen=True)
class DisplayClip:
    """A clip with the images of some methods at one budget."""

    name: str
    target_spp: float
    rows: tuple[DisplayImages, ...]
    reference: UInt8[Array, "t h w 3"] | None  # clipped sRGB


def display_clips(
    clip: ShownClip,
    methods: Sequence[str],
    target_spp: Collection[float],
    scores: pd.DataFrame,
    with_reference: bool = False,
) -> Iterator[DisplayClip]:
    """The images of `methods`, in their order, at each budget; `scores` are rows of the results.

    All of them must be among the images of `clip`.
    """
    reference = _to_display(clip.reference) if with_reference else None
    by_key = {(each.method, each.target_spp): each for each in clip.images}
    for spp in target_spp:
        rows = (_display_images(by_key[method, spp], clip.name, scores) for method in methods)
        yield DisplayClip(clip.name, spp, tuple(rows), reference)


def _display_images(images: ShownImages, clip: str, scores: pd.DataFrame) -> DisplayImages:
    is_own = (scores["method"] == images.method) & (scores["clip"] == clip)
    is_own &= (scores["target_spp"] == images.target_spp) & (scores["seed"] == images.seed)
    is_own &= (scores["device"] == images.device) & (scores["metric"] == "psnr")
    by_frame = scores[is_own].set_index("frame")["value"].to_dict()
    psnr = tuple(by_frame.get(frame, math.nan) for frame in range(len(images.frames)))
    return DisplayImages(images.method, _to_display(images.frames), images.counts, psnr)


def _to_display(frames: Float[Array, "t 3 h w"]) -> UInt8[Array, "t h w 3"]:
    return np.stack(
        [LinearImage(np.moveaxis(frame.astype(np.float32), 0, -1)).rgb8 for frame in frames]
    )

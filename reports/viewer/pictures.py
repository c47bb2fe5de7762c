"""The images of a page, rounded as finely as its size allows."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from reports.viewer.tiles import LinearScale, LogScale, encode
from rlbench.benchmark.results import TableError

__all__ = ["MAX_METHODS", "PicturesError", "ShownClip", "ShownImages", "pack_clips"]

MAX_METHODS = 9  # at each clip and budget: one for each of the keys 1 to 9
STEPS = (256, 128, 96, 64, 48, 32, 24, 20, 16, 14, 12, 10, 8)  # of radiance in an octave
MARGIN = 0.02  # by which the size is overestimated from the first frames
SCALES = {
    "albedo": LinearScale(1 / 255),
    "normal": LinearScale(1 / 64),
    "depth": LogScale(64),
    "motion": LinearScale(1 / 16),  # pixels
}
COUNTS = LinearScale(1.0)
Floats = NDArray[np.floating[Any]]


class PicturesError(TableError):
    """Images that do not fit a page."""


class ShownImages(Protocol):
    """The output of one method on a clip."""

    method: str
    target_spp: float
    frames: Floats  # [t 3 h w], linear radiance
    counts: Floats  # [t h w], samples of each pixel


class ShownClip(Protocol):
    """A clip with the images of all methods on it."""

    name: str
    scene: str
    fps: float
    cuts: Sequence[int]
    reference: Floats  # [t 3 h w], linear radiance
    buffers: Mapping[str, Floats]  # [t c h w]
    images: Sequence[ShownImages]


def pack_clips(clips: Sequence[ShownClip], max_bytes: int) -> tuple[list[str], float]:
    """Each clip as JSON text, with the finest rounding that fits, and its relative error.

    Raises PicturesError if even the coarsest rounding does not fit.
    """
    length = max((len(clip.reference) for clip in clips), default=0)
    smallest = 0
    for steps in STEPS:
        scale = LogScale(steps)
        sample = sum(len(text) for text in _packed(clips, scale, frames=1))
        smallest = int(sample * length * (1 + MARGIN))
        if smallest > max_bytes:
            continue
        texts = list(_packed(clips, scale, frames=length))
        smallest = sum(map(len, texts))
        if smallest <= max_bytes:
            return texts, scale.relative_error
    raise PicturesError(
        f"the images need {smallest / 1e6:.0f} MB, and {max_bytes / 1e6:.0f} MB are left for them. "
        "Show fewer with --methods, --scenes or --spp, or allow a larger page with --max-mb"
    )


def _packed(clips: Sequence[ShownClip], scale: LogScale, frames: int) -> Iterator[str]:
    return (_pack_clip(clip, scale, min(frames, len(clip.reference))) for clip in clips)


def _pack_clip(clip: ShownClip, scale: LogScale, frames: int) -> str:
    _, _, height, width = clip.reference.shape
    document = {
        "name": clip.name,
        "scene": clip.scene,
        "fps": clip.fps,
        "cuts": list(clip.cuts),
        "frames": frames,
        "width": width,
        "height": height,
        "reference": [encode(image, scale) for image in clip.reference[:frames]],
        "buffers": {
            name: [encode(image, SCALES[name]) for image in images[:frames]]
            for name, images in clip.buffers.items()
        },
        "images": [
            {
                "method": each.method,
                "spp": each.target_spp,
                "frames": [encode(image, scale) for image in each.frames[:frames]],
                "counts": [encode(counts[None], COUNTS) for counts in each.counts[:frames]],
            }
            for each in clip.images
        ],
    }
    return json.dumps(document, separators=(",", ":"))

"""The images of a page, rounded as finely as its size allows."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rlbench.apps.view.viewer.tiles import LinearScale, LogScale, encode
from rlbench.benchmark.results import TableError

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

MAX_METHODS = 9  # at each clip and budget: one for each of the keys 1 to 9
STEPS = (256, 128, 96, 64, 48, 32, 24, 20, 16, 14, 12, 10, 8)  # of radiance in an octave
MARGIN = 0.01  # by which the size is overestimated from the middle frames
SCALES: dict[str, LinearScale | LogScale] = {
    "albedo": LinearScale(1 / 64),
    "normal": LinearScale(1 / 32),
    "depth": LogScale(64),
    "motion": LinearScale(1 / 16),  # pixels
}
COUNTS = LinearScale(1.0)


class PicturesError(TableError):
    """Images that do not fit a page."""


def pack_clips(clips: Sequence[ShownClip], max_bytes: int) -> tuple[list[str], float]:
    """Each clip as JSON text, with the finest rounding that fits, and its relative error.

    Without clips there is no text, and the error is 0. Raises PicturesError if even the coarsest
    rounding does not fit.
    """

    if not clips:
        return [], 0.0

    def fits_roughly(steps: int) -> bool:
        size = sum(_length(clip) * len(_pack_clip(clip, LogScale(steps), True)) for clip in clips)
        return size * (1 + MARGIN) <= max_bytes

    first = min(bisect_left(STEPS, True, key=fits_roughly), len(STEPS) - 1)
    size = 0
    for steps in STEPS[first:]:
        scale = LogScale(steps)
        texts = [_pack_clip(clip, scale) for clip in clips]
        size = sum(map(len, texts))
        if size <= max_bytes:
            return texts, scale.relative_error
    raise PicturesError(
        f"the images need {size / 1e6:.3g} MB, and {max_bytes / 1e6:.3g} MB are left for them. "
        "Show fewer, of results with --methods, --scenes or --spp, or allow a larger page with "
        "--max-mb"
    )


def _pack_clip(clip: ShownClip, scale: LogScale, middle_only: bool = False) -> str:
    """A clip as JSON text; `middle_only`: with its middle frame alone, to estimate its size."""
    length, (height, width) = _length(clip), clip.reference.shape[2:]
    part = slice(length // 2, length // 2 + 1) if middle_only else slice(None)
    document = {
        "name": clip.name,
        "scene": clip.scene,
        "fps": clip.fps,
        "cuts": list(clip.cuts),
        "light_changes": list(clip.light_changes),
        "frames": length,
        "width": width,
        "height": height,
        "reference": [encode(image, scale) for image in clip.reference[part]],
        "buffers": {
            name: [encode(image, SCALES[name]) for image in images[part]]
            for name, images in clip.buffers.items()
        },
        "images": [
            {
                "method": each.method,
                "spp": each.target_spp,
                "frames": [encode(image, scale) for image in each.frames[part]],
                "counts": [encode(counts[None], COUNTS) for counts in each.counts[part]],
            }
            for each in clip.images
        ],
    }
    return json.dumps(document, separators=(",", ":"))


def _length(clip: ShownClip) -> int:
    """Number of frames."""
    return max(len(each.frames) for each in clip.images)

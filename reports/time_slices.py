"""One image row over time: flicker is seen as noise along time, lag as slanted trails."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from reports.analysis.images import (
    Floats,
    decibels,
    encode_srgb,
    first_of_scenes,
    select_images,
    squared_error,
)
from reports.layout.files import write_figure
from reports.layout.image_grid import add_caption, draw_picture
from reports.layout.page import describe_clips

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

USUAL = ("ours", "ntas", "oidn/tuned", "accumulate/contrast")
MAX_ROWS, MAX_SCENES = 4, 4
LINE_COLOUR = "#E69F00"
WIDTH, BLOCK, FOOTER = 13.0, 2.75, 0.85  # inches
FRAME_SHARE = 0.2  # of the width, for the frame


@dataclass(frozen=True, eq=False)
class TimeSlice:
    """An image row of a clip in all frames, of the reference and of each method."""

    clip: str
    scene: str
    target_spp: float
    row: int
    middle: Floats  # [3 h w], the reference in the middle of the clip
    reference: Floats  # [3 t w], linear
    images: dict[str, Floats]  # [3 t w], by method


def write(
    results: pd.DataFrame,
    folder: Path,
    clips: Iterable[ShownClip],
    methods: Sequence[str] = (),
    name: str = "slices",
) -> list[Path]:
    """Write `name`.png, .pdf, .svg and a .csv of errors and flicker; first clip of four scenes.

    Of the first four `methods`. Raises MissingRowsError for a method without images.
    """
    slices = [find_slice(clip, methods) for clip in first_of_scenes(clips, MAX_SCENES)]
    table = pd.DataFrame([row for part in slices for row in _records(part)])
    return write_figure(lambda: draw_slices(slices, describe_clips(results)), folder, name, table)


def find_slice(clip: ShownClip, methods: Sequence[str] = ()) -> TimeSlice:
    """The image row in which the flicker of the shown methods differs most."""
    rows = select_images(clip, methods, USUAL, 1, MAX_ROWS)
    length = min(len(row.frames) for row in rows)
    reference = clip.reference[:length]
    levels = [flicker(row.frames[:length], reference).mean(axis=(0, 2)) for row in rows]
    spread = np.max(levels, axis=0) - np.min(levels, axis=0) if len(rows) > 1 else levels[0]
    line = int(spread.argmax())
    images = {row.method: np.asarray(row.frames[:length, :, line]).swapaxes(0, 1) for row in rows}
    middle = reference[length // 2]
    cut = reference[:, :, line].swapaxes(0, 1)
    return TimeSlice(clip.name, clip.scene, rows[0].target_spp, line, middle, cut, images)


def flicker(frames: Floats, reference: Floats) -> Floats:
    """Squared change of the error from frame to frame [t-1 h w], sRGB, mean over channels.

    What changes in the reference too is no flicker. Both images are linear, [t 3 h w].
    """
    error = encode_srgb(frames) - encode_srgb(reference)
    changes: Floats = (np.diff(error, axis=0) ** 2).mean(axis=1)
    return changes


def draw_slices(slices: Sequence[TimeSlice], clips: str) -> Figure:
    """The figure: for each clip a frame with the row marked, and the row over time, by method."""
    height = BLOCK * len(slices) + FOOTER
    figure = Figure(figsize=(WIDTH, height))
    lines = 1 + max(len(part.images) for part in slices)
    outer = figure.add_gridspec(
        len(slices), 2, width_ratios=[FRAME_SHARE, 1 - FRAME_SHARE], left=0.008, right=0.992,
        top=1 - 0.3 / height, bottom=FOOTER / height, wspace=0.23, hspace=0.17,
    )  # fmt: skip
    for index, part in enumerate(slices):
        axes = figure.add_subplot(outer[index, 0])
        draw_picture(axes, part.middle, f"{part.clip}: row {part.row}")
        axes.axhline(part.row, color=LINE_COLOUR, lw=1.6)
        inner = outer[index, 1].subgridspec(lines, 1, hspace=0.08)
        for place, (method, cut) in enumerate(
            [("reference", part.reference), *part.images.items()]
        ):
            axes = figure.add_subplot(inner[place])
            draw_picture(axes, cut)
            axes.set_aspect("auto")
            axes.set_ylabel(_label(part, method), rotation=0, ha="right", va="center", fontsize=10)
    add_caption(
        figure,
        f"{slices[0].target_spp:g} spp, {clips}. Each strip is the marked row of the image in all "
        "frames, time downwards. Flicker: PSNR of the change of the error from frame to frame in "
        "the row; higher is steadier. The row is that in which the flicker of the shown methods "
        "differs most.",
    )
    return figure


def _label(part: TimeSlice, method: str) -> str:
    if method not in part.images:
        return method
    return f"{method}\n{decibels(_row_flicker(part, method)):.1f} dB"


def _row_flicker(part: TimeSlice, method: str) -> float:
    """Flicker of a method in the row."""
    frames, reference = (
        each.swapaxes(0, 1)[:, :, None] for each in (part.images[method], part.reference)
    )
    return float(flicker(frames, reference).mean())


def _records(part: TimeSlice) -> list[dict[str, object]]:
    """The numbers of a clip's row."""
    return [
        {
            "clip": part.clip,
            "scene": part.scene,
            "target_spp": part.target_spp,
            "row": part.row,
            "method": method,
            "flicker_psnr": decibels(_row_flicker(part, method)),
            "psnr": decibels(float(squared_error(image[:, None], part.reference[:, None]).mean())),
        }
        for method, image in part.images.items()
    ]

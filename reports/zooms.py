"""Crops of reference and outputs, chosen by rule, with the PSNR of crop and frame.

The difference of a crop is that of the mean squared errors of the two images in it. The first crop
has the largest difference of all frames. The second is of the same frame and does not touch the
first: of all such crops of the frame it has the median difference. Nobody chooses by eye.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.lib.stride_tricks import sliding_window_view

from reports.analysis.images import (
    Floats,
    best_first,
    decibels,
    first_of_scenes,
    select_images,
    squared_error,
)
from reports.layout.files import write_figure
from reports.layout.image_grid import add_caption, draw_picture
from reports.layout.page import describe_clips

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

USUAL = ("ours", "ntas")  # as in the paper's figure
MIN_ROWS, USUAL_ROWS, MAX_ROWS, MAX_SCENES = 2, 5, 8, 4
RULES = ("largest difference", "median difference")
WIDTH, CAPTION, GAP = 13.0, 0.62, 0.06  # inches; GAP between crops
LETTER = 0.68  # width of a bold letter, in its size
SHARE = 0.2  # side of a crop, as a share of the shorter side of the frame
STEPS = 4  # positions of crops within the side of one
CROP_COLOURS = ("#E69F00", "#56B4E9")  # Okabe and Ito 2008; both are seen on dark and bright


def write(
    results: pd.DataFrame,
    folder: Path,
    clips: Iterable[ShownClip],
    methods: Sequence[str] = (),
    name: str = "zooms",
) -> list[Path]:
    """Write `name`.png, .pdf, .svg and a .csv of crops and PSNR; the first clip of four scenes.

    Up to MAX_ROWS `methods` are shown in their order; the crops are chosen by the first two.
    Without methods, ours and ntas come first, then the best. Raises MissingRowsError where fewer
    than two methods have images.
    """
    usual = (*USUAL, *best_first(results))
    zooms = [find_zoom(clip, methods, usual) for clip in first_of_scenes(clips, MAX_SCENES)]
    table = pd.DataFrame([row for zoom in zooms for row in _records(zoom)])
    return write_figure(lambda: draw_zooms(zooms, describe_clips(results)), folder, name, table)


class Crop(NamedTuple):
    """A square of a frame, in pixels."""

    frame: int
    top: int
    left: int
    side: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the crop."""
        rows = slice(self.top, self.top + self.side)
        return rows, slice(self.left, self.left + self.side)


def choose_crops(error: Floats, other: Floats) -> tuple[Crop, Crop]:
    """The crops with the largest and a median difference of two squared errors [t h w].

    >>> error = np.zeros((2, 50, 50)); error[1, 20:30, 30:40] = 1.0
    >>> choose_crops(error, np.zeros_like(error))[0]
    Crop(frame=1, top=20, left=30, side=10)
    """
    _, height, width = error.shape
    side = max(round(SHARE * min(height, width)), 1)
    step = max(side // STEPS, 1)
    difference = np.abs(_window_means(error - other, side, step))  # t rows columns
    frame, row, column = np.unravel_index(int(difference.argmax()), difference.shape)
    largest = Crop(int(frame), int(row) * step, int(column) * step, side)
    rows, columns = np.indices(difference.shape[1:]) * step
    is_apart = (abs(rows - largest.top) >= side) | (abs(columns - largest.left) >= side)
    order = np.argsort(difference[frame], axis=None, kind="stable")
    order = order[is_apart.ravel()[order]]
    middle = order[len(order) // 2]
    return largest, Crop(int(frame), int(rows.flat[middle]), int(columns.flat[middle]), side)


def _window_means(values: Floats, side: int, step: int) -> Floats:
    """Mean of each square of `side` pixels, every `step` pixels: [t rows columns]."""
    rows = sliding_window_view(values, side, axis=1)[:, ::step].mean(axis=-1)
    means: Floats = sliding_window_view(rows, side, axis=2)[:, :, ::step].mean(axis=-1)
    return means


@dataclass(frozen=True, eq=False)
class Zoom:
    """A frame of a clip with its two crops, and the images of all rows."""

    clip: str
    scene: str
    target_spp: float
    crops: tuple[Crop, Crop]
    reference: Floats  # [3 h w], linear
    images: dict[str, Floats]  # by method

    @property
    def frame(self) -> int:
        """Index of the frame."""
        return self.crops[0].frame

    def psnr(self, method: str, crop: Crop | None = None) -> float:
        """PSNR in dB of the frame, or of a crop."""
        error = squared_error(self.images[method], self.reference)
        return decibels(float(error[crop.slices if crop else ...].mean()))


def find_zoom(clip: ShownClip, methods: Sequence[str] = (), usual: Sequence[str] = USUAL) -> Zoom:
    """The frame and the crops of a clip in which its first two rows differ."""
    rows = select_images(clip, methods, usual, MIN_ROWS, MAX_ROWS if methods else USUAL_ROWS)
    length = min(len(row.frames) for row in rows[:2])
    first, second = (
        squared_error(row.frames[:length], clip.reference[:length]) for row in rows[:2]
    )
    crops = choose_crops(first, second)
    frame = crops[0].frame
    images = {row.method: np.asarray(row.frames[frame]) for row in rows}
    spp = rows[0].target_spp
    return Zoom(clip.name, clip.scene, spp, crops, clip.reference[frame], images)


def draw_zooms(zooms: Sequence[Zoom], clips: str) -> Figure:
    """The figure: for each clip its frame at the left, and its crops in two rows at the right."""
    columns = 1 + max(len(zoom.images) for zoom in zooms)
    side = (WIDTH - 0.55 - GAP * columns) / (columns + 2)  # inches, of a crop
    block = 2 * side + 0.92
    height = block * len(zooms) + CAPTION
    figure = Figure(figsize=(WIDTH, height))
    for index, zoom in enumerate(zooms):
        top = height - 0.62 - block * index
        h, w = zoom.reference.shape[1:]
        frame_side = 2 * side + 0.22
        fit = min(1.0, w / h)  # as large as the two crops
        tall = frame_side * min(1.0, h / w)
        place = _box(figure, 0.1, top - tall, frame_side * fit, tall)
        axes = figure.add_axes(place)
        draw_picture(axes, zoom.reference, f"{zoom.clip}, frame {zoom.frame}: reference")
        for crop, colour in zip(zoom.crops, CROP_COLOURS, strict=True):
            corner = crop.left - 0.5, crop.top - 0.5
            axes.add_patch(Rectangle(corner, crop.side, crop.side, fill=False, ec=colour, lw=2.2))
        for row, crop in enumerate(zoom.crops):
            bottom = top - side - row * (side + 0.22)
            _draw_crops(figure, zoom, row, crop, (frame_side + 0.2, bottom, side))
    chosen = list(zooms[0].images)[:2]
    add_caption(
        figure,
        f"{zooms[0].target_spp:g} spp, {clips}. Above the crops: PSNR of the frame (bold) and of "
        f"the crop. A crop has {SHARE:.0%} of the frame's side".replace("%", " %")
        + f". Chosen by rule: orange, where the squared errors of {' and '.join(chosen)} differ "
        "most in any frame; blue, the median difference in the same frame.",
    )
    return figure


def _draw_crops(
    figure: Figure, zoom: Zoom, row: int, crop: Crop, place: tuple[float, float, float]
) -> None:
    """A row of crops, the reference first, from a left and lower edge on, in inches."""
    left, bottom, side = place
    rows, columns = crop.slices
    for index, method in enumerate([None, *zoom.images]):
        axes = figure.add_axes(_box(figure, left + index * (side + GAP), bottom, side, side))
        image = zoom.images[method] if method else zoom.reference
        draw_picture(axes, image[:, rows, columns])
        for spine in axes.spines.values():
            spine.set(visible=True, edgecolor=CROP_COLOURS[row], linewidth=2.2)
        if row == 0:
            text = f"{method}\n{zoom.psnr(method):.2f} dB" if method else "reference"
            size = min(11.0, 72 * side / (LETTER * len(method or text)))  # a long name fits too
            axes.text(0.5, 1 + 0.2 / side, text, transform=axes.transAxes, ha="center",
                      fontsize=size, fontweight="bold")  # fmt: skip
        text = f"{zoom.psnr(method, crop):.2f} dB" if method else RULES[row]
        axes.set_title(text, fontsize=10, pad=3)


def _box(
    figure: Figure, left: float, bottom: float, width: float, height: float
) -> tuple[float, float, float, float]:
    """A box in inches as shares of the figure."""
    wide, tall = figure.get_size_inches()
    return left / wide, bottom / tall, width / wide, height / tall


def _records(zoom: Zoom) -> list[dict[str, object]]:
    """The numbers of a clip's crops, and where they are."""
    return [
        {
            "clip": zoom.clip,
            "scene": zoom.scene,
            "target_spp": zoom.target_spp,
            "rule": rule,
            **crop._asdict(),
            "method": method,
            "crop_psnr": zoom.psnr(method, crop),
            "frame_psnr": zoom.psnr(method),
        }
        for rule, crop in zip(RULES, zoom.crops, strict=True)
        for method in zoom.images
    ]

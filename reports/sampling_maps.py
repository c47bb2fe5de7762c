"""Where rows spent their samples, on one scale, and the error that they had there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import ndimage, stats

from reports.analysis.images import (
    Floats,
    decibels,
    first_of_scenes,
    select_images,
    squared_error,
)
from reports.layout.files import write_figure
from reports.layout.image_grid import (
    FOOTER,
    add_caption,
    add_colour_bar,
    draw_map,
    draw_picture,
    end_of_scale,
    hide_axes,
)
from reports.layout.page import describe_clips
from rlbench.benchmark.results import MissingRowsError

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

USUAL = ("ours", "ours/A1", "ntas")
MAX_ROWS, MAX_SCENES = 3, 4
WINDOW = 9  # pixels across; error and samples are compared as means of such windows
WIDTH, TITLES = 13.0, 0.52  # inches


@dataclass(frozen=True, eq=False)
class SampledFrame:
    """The last frame of a clip: samples of each pixel and squared error, by method."""

    clip: str
    scene: str
    frame: int
    target_spp: float
    reference: Floats  # [3 h w], linear
    counts: dict[str, Floats]  # [h w]
    errors: dict[str, Floats]  # [h w]

    def rank_correlation(self, method: str) -> float:
        """Spearman's correlation of samples and squared error, means of windows; nan if uniform."""
        maps = (self.counts[method], self.errors[method])
        means = [ndimage.uniform_filter(each, WINDOW)[::WINDOW, ::WINDOW].ravel() for each in maps]
        if np.ptp(means[0]) == 0 or np.ptp(means[1]) == 0:
            return float("nan")
        return float(stats.spearmanr(*means).statistic)


def write(
    results: pd.DataFrame,
    folder: Path,
    clips: Iterable[ShownClip],
    methods: Sequence[str] = (),
    name: str = "sampling-maps",
) -> list[Path]:
    """Write `name`.png, .pdf, .svg and a .csv of the distributions; the first clip of four scenes.

    Of the first three `methods`; without them, of those that do not sample uniformly. Raises
    MissingRowsError where all sample uniformly.
    """
    frames = [find_samples(clip, methods) for clip in first_of_scenes(clips, MAX_SCENES)]
    table = pd.DataFrame([row for frame in frames for row in _describe(frame)])
    return write_figure(lambda: draw_sampling(frames, describe_clips(results)), folder, name, table)


def find_samples(clip: ShownClip, methods: Sequence[str] = ()) -> SampledFrame:
    """Samples and errors of the last frame, by when methods with a memory have settled."""
    rows = select_images(clip, methods, USUAL, 1, len(clip.images))
    index = min(len(row.frames) for row in rows) - 1
    counts = {row.method: row.counts[index].astype(np.float32) for row in rows}
    chosen = list(methods) or [name for name in counts if not is_uniform(counts[name])]
    if not chosen:
        raise MissingRowsError(
            f"all methods with images on {clip.name} sample uniformly ({', '.join(counts)}). Run "
            "an adaptive method, such as ours, with --keep-images"
        )
    chosen = chosen[:MAX_ROWS]
    reference = clip.reference[index]
    errors = {
        row.method: squared_error(np.asarray(row.frames[index]), reference)
        for row in rows
        if row.method in chosen
    }
    counts = {name: counts[name] for name in chosen}
    spp = rows[0].target_spp
    return SampledFrame(clip.name, clip.scene, index, spp, reference, counts, errors)


def is_uniform(counts: Floats) -> bool:
    """True if the samples of two pixels differ by no more than a rounded budget makes them."""
    return bool(counts.max() - counts.min() <= 1)


def draw_sampling(frames: Sequence[SampledFrame], clips: str) -> Figure:
    """The figure: for each clip the frame, the samples of each row, and then their errors."""
    methods = max(len(frame.counts) for frame in frames)
    columns = 1 + 2 * methods
    height = (WIDTH / columns + TITLES) * len(frames) + FOOTER
    figure = Figure(figsize=(WIDTH, height))
    grid = figure.subplots(
        len(frames), columns, squeeze=False,
        gridspec_kw={"left": 0.006, "right": 0.994, "top": 1 - TITLES / height,
                     "bottom": FOOTER / height, "wspace": 0.03, "hspace": 0.27},
    )  # fmt: skip
    for axes in grid.flat:
        hide_axes(axes)
    most = end_of_scale(counts for frame in frames for counts in frame.counts.values())
    limit = end_of_scale(np.sqrt(e) for frame in frames for e in frame.errors.values())
    for panels, frame in zip(grid, frames, strict=True):
        draw_picture(panels[0], frame.reference, f"{frame.clip}, frame {frame.frame}\nreference")
        for index, (method, counts) in enumerate(frame.counts.items()):
            text = f"{counts.min():.0f} to {counts.max():.0f} samples, "
            text += f"{frame.rank_correlation(method):.2f}"
            sampled, erred = panels[1 + index], panels[1 + methods + index]
            samples = draw_map(
                sampled, counts, f"{method}\n{text}", cmap="viridis", vmin=0, vmax=most
            )
            error = frame.errors[method]
            text = f"{method}\nerror: {decibels(float(error.mean())):.2f} dB"
            drawn = draw_map(erred, np.sqrt(error), text, cmap="magma", vmin=0, vmax=limit)
    add_colour_bar(figure, samples, "samples per pixel", (0.16, 0.34), "max")
    label = "root of the squared error in sRGB, mean over channels"
    add_colour_bar(figure, drawn, label, (0.6, 0.34), "max")
    add_caption(
        figure,
        f"{frames[0].target_spp:g} spp, {clips}; last frame of each clip. All panels of samples "
        "share one scale, and so do all errors. The number after the samples is Spearman's rank "
        f"correlation of samples and squared error, as means of {WINDOW}x{WINDOW} pixels.",
    )
    return figure


def _describe(frame: SampledFrame) -> list[dict[str, object]]:
    """The distribution of the samples of each row in numbers."""
    return [
        {
            "clip": frame.clip,
            "scene": frame.scene,
            "target_spp": frame.target_spp,
            "frame": frame.frame,
            "method": method,
            "mean_spp": float(counts.mean()),
            "deviation": float(counts.std()),
            "least": float(counts.min()),
            "most": float(counts.max()),
            "without_samples": float((counts == 0).mean()),
            "rank_correlation": frame.rank_correlation(method),
            "psnr": decibels(float(frame.errors[method].mean())),
        }
        for method, counts in frame.counts.items()
    ]

"""Where one row has less error than another: signed maps, large differences, and histograms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from reports.analysis.images import (
    Floats,
    best_first,
    first_of_scenes,
    select_images,
    squared_error,
)
from reports.layout import style
from reports.layout.files import write_figure
from reports.layout.image_grid import (
    FOOTER,
    add_caption,
    add_colour_bar,
    draw_map,
    draw_picture,
    end_of_scale,
)
from reports.layout.page import describe_clips

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rlbench.benchmark.shown_clips import ShownClip

USUAL = ("ours", "ours/A1")  # learned by reward, and by a surrogate gradient, as in the paper
MAX_SCENES = 4
COLOURS = "RdBu_r"  # Harrower and Brewer 2003: safe for colour-blind readers; red is worse
BETTER, NEITHER, WORSE = "#2166AC", "#F2F2F2", "#B2182B"  # its ends
LARGE_PERCENTILE = 95.0  # of the sizes of all differences: above it one is large
BINS = 61
WIDTH, PANEL = 13.0, 3.1  # inches


@dataclass(frozen=True, eq=False)
class Difference:
    """Squared error of a row minus that of another, on all frames of a clip."""

    clip: str
    scene: str
    methods: tuple[str, str]
    target_spp: float
    values: Floats  # [t h w]
    reference: Floats  # [t 3 h w], linear

    @property
    def typical_frame(self) -> int:
        """The frame whose mean difference is the median of the clip's frames."""
        means = self.values.mean(axis=(1, 2))
        return int(np.argsort(means, kind="stable")[len(means) // 2])


def write(
    results: pd.DataFrame,
    folder: Path,
    clips: Iterable[ShownClip],
    methods: Sequence[str] = (),
    name: str = "difference-map",
) -> list[Path]:
    """Write `name`.png, .pdf, .svg and a .csv of the distributions; the first clip of four scenes.

    Of the first two `methods`, without them of ours and ours/A1, or of the two best. Raises
    MissingRowsError where fewer than two methods have images.
    """
    usual = (*USUAL, *best_first(results))
    if not {*USUAL} <= set(results["method"]):
        usual = tuple(best_first(results))  # the winner and the runner-up
    parts = [find_difference(clip, methods, usual) for clip in first_of_scenes(clips, MAX_SCENES)]
    large = large_difference(parts)
    table = pd.DataFrame([_describe(part, large) for part in parts])
    clips_text = describe_clips(results)
    return write_figure(lambda: draw_differences(parts, clips_text), folder, name, table)


def find_difference(
    clip: ShownClip, methods: Sequence[str] = (), usual: Sequence[str] = USUAL
) -> Difference:
    """Squared error of the first row minus that of the second, in sRGB, mean over channels."""
    rows = select_images(clip, methods, usual, 2, 2)
    length = min(len(row.frames) for row in rows)
    reference = clip.reference[:length]
    first, second = (squared_error(row.frames[:length], reference) for row in rows)
    pair = rows[0].method, rows[1].method
    return Difference(clip.name, clip.scene, pair, rows[0].target_spp, first - second, reference)


def large_difference(parts: Sequence[Difference]) -> float:
    """The size above which a difference is large: LARGE_PERCENTILE of all pixels."""
    return float(
        np.percentile(np.abs(np.concatenate([p.values.ravel() for p in parts])), LARGE_PERCENTILE)
    )


def draw_differences(parts: Sequence[Difference], clips: str) -> Figure:
    """The figure: for each clip a frame, the signed map, large differences, and a histogram."""
    height = PANEL * len(parts) + FOOTER
    figure = Figure(figsize=(WIDTH, height))
    grid = figure.subplots(
        len(parts), 4, squeeze=False, width_ratios=[1, 1, 1, 1.3],
        gridspec_kw={"left": 0.008, "right": 0.955, "top": 1 - 0.3 / height,
                     "bottom": FOOTER / height, "wspace": 0.04, "hspace": 0.2},
    )  # fmt: skip
    limit, large = end_of_scale(part.values for part in parts), large_difference(parts)
    first, second = parts[0].methods
    for (picture, signed, binary, histogram), part in zip(grid, parts, strict=True):
        frame = part.typical_frame
        values = part.values[frame]
        draw_picture(picture, part.reference[frame], f"{part.clip}, frame {frame}: reference")
        drawn = draw_map(
            signed, values, f"{first} minus {second}", cmap=COLOURS, vmin=-limit, vmax=limit
        )
        signs = np.sign(values) * (np.abs(values) > large)
        colours = ListedColormap([BETTER, NEITHER, WORSE])
        draw_map(binary, signs, "large differences", cmap=colours, vmin=-1, vmax=1)
        _draw_histogram(histogram, part.values, limit)
    label = f"squared error of {first} minus that of {second}; blue: {first} is better"
    add_colour_bar(figure, drawn, label, (0.2, 0.3), "both")
    add_caption(
        figure,
        f"{parts[0].target_spp:g} spp, {clips}. Squared error in sRGB, mean over channels. Of each "
        "clip the frame with the median of the frames' mean differences; histograms: all frames, "
        f"dashed: mean. Large: above {large:.2g}, the {LARGE_PERCENTILE:g}th percentile of sizes; "
        f"blue where {second} is worse, red where {first} is.",
    )
    return figure


def _draw_histogram(axes: Axes, values: Floats, limit: float) -> None:
    """Share of pixels by difference, logarithmic; the outer bins hold all beyond the scale."""
    edges = np.linspace(-limit, limit, BINS + 1)
    counts, _ = np.histogram(values.clip(-limit, limit), edges)
    colours = [BETTER if right <= 0 else WORSE if left >= 0 else style.GREY
               for left, right in zip(edges[:-1], edges[1:], strict=True)]  # fmt: skip
    axes.bar(edges[:-1], counts / values.size, np.diff(edges), align="edge", color=colours)
    axes.set_yscale("log")
    axes.axvline(float(values.mean()), color=style.BLACK, ls="--", lw=1.2)
    axes.set_xlim(-limit, limit)
    axes.set_title(f"share of pixels; mean {values.mean():+.1e}", fontsize=10.5, pad=4)
    axes.tick_params(labelsize=10)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.tick_right()
    axes.spines["right"].set_visible(True)
    axes.spines["left"].set_visible(False)


def _describe(part: Difference, large: float) -> dict[str, object]:
    """The distribution of a clip's differences in numbers."""
    values = part.values
    return {
        "clip": part.clip,
        "scene": part.scene,
        "method": part.methods[0],
        "other": part.methods[1],
        "target_spp": part.target_spp,
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "better": float((values < 0).mean()),
        "worse": float((values > 0).mean()),
        "large": large,
        "much_better": float((values < -large).mean()),
        "much_worse": float((values > large).mean()),
    }

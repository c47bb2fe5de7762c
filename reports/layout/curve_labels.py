"""Names beside the ends of curves, in the order of the ends, and the points that a curve joins."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.textpath import TextPath

from reports.layout.style import LineStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MARKER_SIZE, STAR_SIZE = 7.5, 11.0  # points across; a star of the same width looks smaller
LABEL_SIZE, LABEL_DISTANCE = 10.5, 0.205  # points; inches between two labels
POINTS, HINTED = 72.0, 1.08  # points in an inch; letters on a grid of pixels are up to 8 % wider
LABEL_START = 1.07  # where a label begins, as a share of its panel's width


def label_curves(
    axes: Axes,
    ends: Sequence[tuple[str, float, float]],
    styles: Mapping[str, LineStyle],
    height: float,
    number_format: str,
    hollow: bool | None = None,
) -> None:
    """Write name and last value of each curve at the right, without overlaps, with leader lines.

    `ends` has name, x and y of each curve; `height` is that of the panel in inches. Markers are as
    in `styles`, or all hollow, or all filled.
    """
    if not ends:
        return
    low, high = axes.get_ylim()
    is_log = axes.get_yscale() == "log"
    low, high = (math.log(low), math.log(high)) if is_log else (low, high)
    step = (high - low) * LABEL_DISTANCE / (0.93 * height)  # a panel's share of the height
    ends = sorted(ends, key=lambda end: end[2])
    values = [math.log(y) if is_log else y for _, _, y in ends]
    heights = spread_labels([min(max(low, value), high) for value in values], step, low, high)
    for (method, x, value), place in zip(ends, heights, strict=True):
        line = styles[method]
        face = line.face if hollow is None else "white" if hollow else line.color
        end = max(axes.get_ylim()[0], value)
        place = math.exp(place) if is_log else place
        axes.annotate(
            "", (x, end), (1.025, place), xycoords="data",
            textcoords=axes.get_yaxis_transform(), annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": line.color, "alpha": 0.5, "lw": 0.7,
                        "shrinkA": 0, "shrinkB": 4, "zorder": 1},
        )  # fmt: skip
        axes.plot(
            [1.04], [place], transform=axes.get_yaxis_transform(), clip_on=False, ls="",
            marker=line.marker, ms=marker_size(line) - 1, c=line.color, mec=line.color, mfc=face,
        )  # fmt: skip
        axes.text(
            LABEL_START, place, _label(method, value, number_format), va="center",
            transform=axes.get_yaxis_transform(), fontsize=LABEL_SIZE, color=line.color,
        )  # fmt: skip


def label_width(curves: Iterable[tuple[str, float]], number_format: str) -> float:
    """Inches that the widest label needs; `curves` has names and values, at an end or anywhere.

    A panel needs this room at its right, after LABEL_START times its own width.
    """
    texts = {_label(method, value, number_format) for method, value in curves}
    widths = (TextPath((0, 0), text, size=LABEL_SIZE).get_extents().xmax for text in texts)
    return max(widths, default=0.0) / POINTS * HINTED


def marker_size(line: LineStyle) -> float:
    """Width of a method's marker in points."""
    return STAR_SIZE if line.marker == "*" else MARKER_SIZE


def spread_labels(heights: list[float], step: float, low: float, high: float) -> list[float]:
    """Ascending heights, moved as little as possible to be at least `step` apart within bounds.

    Heights that do not all fit are spread evenly over the bounds.

    >>> spread_labels([5.0, 5.0], step=1.0, low=0.0, high=10.0)
    [4.5, 5.5]
    """
    count = len(heights)
    if (count - 1) * step >= high - low:
        return [low + (high - low) * i / max(count - 1, 1) for i in range(count)]
    # isotonic regression (pool adjacent violators): heights that are too near form a block
    blocks: list[tuple[float, int]] = []  # mean of heights minus their steps, and their number
    for i, height in enumerate(heights):
        mean, size = height - i * step, 1
        while blocks and blocks[-1][0] > mean:
            last, count_of_last = blocks.pop()
            total = size + count_of_last
            mean, size = (mean * size + last * count_of_last) / total, total
        blocks.append((mean, size))
    means = [mean for mean, size in blocks for _ in range(size)]
    top = high - (count - 1) * step
    return [min(max(mean, low), top) + i * step for i, mean in enumerate(means)]


def _label(method: str, value: float, number_format: str) -> str:
    return f"{method} {value:{number_format}}"


def longest_rise(times: Sequence[float]) -> list[int]:
    """Positions of the longest part of `times` that rises; of equal ones, that which ends first.

    More samples take more time. Where a measured time falls as the budget grows, a busy machine
    disturbed one of the two points; a line through the others does not run backwards.

    >>> longest_rise([10.0, 30.0, 20.0, 25.0, 40.0])
    [0, 2, 3, 4]
    """
    chains: list[list[int]] = []
    for i, time in enumerate(times):
        before = [chain for chain in chains if times[chain[-1]] <= time]
        chains.append([*max(before, key=len, default=[]), i])
    return max(chains, key=len, default=[])

"""The winner map: the best method for each deadline and cost of a sample.

It is hatched where the first two are not resolved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray
from scipy import ndimage

from reports.analysis.curves import (
    NOTHING,
    Curve,
    Numbers,
    Winners,
    curves_of,
    denoisers,
    find_possible_winners,
    find_winners,
    measured_sample_ms,
    methods_without_curve,
)
from reports.analysis.differences import TIE_DB
from reports.analysis.intervals import interval_ends
from reports.analysis.rows import family_of
from reports.analysis.scores import Scores
from reports.layout import style
from reports.layout.page import Drawing, describe_clips, write_figures
from reports.layout.tables import score_name
from rlbench.benchmark.results import MissingRowsError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SAMPLE_MS = (0.1, 1000.0)  # of the vertical axis
COLUMNS, ROWS = 400, 300  # of the map
CSV_STEP = 5  # rows and columns of the map from one row of the CSV to the next
MAP_DRAWS = 1000  # of the bootstrap; the ends of an interval are then stable to about 3 %
LONGEST_MS = 10_000.0  # of the horizontal axis
ROUNDING = 50  # steps a factor e, in which the budgets of compared methods are rounded
WIDTH, HEIGHT = 11.0, 6.6  # inches; the keys and the caption are in it
CAPTION_LETTERS = 145  # in a line
EXHAUSTED = "to the right, no larger\nbudget was measured"
NOTHING_COLOUR = "#F4F4F4"
HATCH = "///"
UNCERTAIN_WHITE = 0.55  # share of white where times are too uncertain to name the winner
LIGHTEST = 0.68  # share of white in the colour of a family's last variant; the first has none
RATES = {"120 Hz": 1000 / 120, "60 Hz": 1000 / 60, "30 Hz": 1000 / 30, "10 Hz": 100, "1 Hz": 1000}
LABEL_INCHES = 0.13  # of the radius of the largest circle in a region, from which it is labelled
BOLD_LETTER_INCHES = 0.115  # of a name in a region
LETTER_INCHES = 0.088  # in the key
MAX_NAMES, MIN_AREA = 8, 0.02  # of the methods with a colour of their own: share of the map
OTHERS_COLOUR = "#B9B9B9"


def write(
    results: pd.DataFrame, folder: Path, metric: str = "psnr", name: str = "winners"
) -> list[Path]:
    """Write the map and a CSV of its cells, see `write_figures`.

    Each cell has the denoiser with the best mean score over scenes whose frame time fits the
    deadline; no region is won by raw samples. A cell is hatched where it ties with the runner-up,
    where their difference is not resolved, or where there is no interval, and pale where times are
    so uncertain that another method may win. Raises MissingRowsError
    if no method has scores and times on every scene.
    """
    return write_figures(results, folder, name, _figures, metric)


def _figures(scores: Scores) -> dict[str, Drawing]:
    known = curves_of(scores)
    curves = denoisers(known)
    if not curves or not scores.direction:
        raise MissingRowsError(
            f"a map of winners needs {scores.metric} and times of a method on every scene; found: "
            f"{'; '.join(methods_without_curve(scores, [])) or 'none'}. Measure with rlbench run"
        )
    margin = TIE_DB if scores.column_text("unit") == "dB" else 0.0
    winners = replace(map_winners(curves), tie_margin=margin)
    caption, cost = _caption(scores, known), measured_sample_ms(scores)
    mixes = "; ".join(f"Two devices: {devices}" for devices in scores.device_mixes)
    heading = mixes or scores.place
    drawing = partial(draw_winner_map, winners, caption, cost, heading)
    return {"": (drawing, winners.table(CSV_STEP))}


@dataclass(frozen=True, eq=False)
class WinnerMap:
    """Cells [costs deadlines] of the map; indices into `methods`, -1 where none fits."""

    methods: tuple[str, ...]
    sample_ms: Numbers  # [costs]
    deadline_ms: Numbers  # [deadlines]
    winner: NDArray[np.intp]
    runner_up: NDArray[np.intp]
    spp: Numbers  # of the winner
    is_at_largest: NDArray[np.bool_]  # the winner is at its largest measured budget
    difference: Numbers  # winner minus runner-up; nan without one
    low: Numbers  # of its interval
    high: Numbers
    is_uncertain: NDArray[np.bool_]  # another method wins at other ends of the times' intervals
    tie_margin: float = 0.0  # of a difference, in the unit of the score

    @property
    def is_open(self) -> NDArray[np.bool_]:
        """Where winner and runner-up tie or are not resolved, or the interval is not known."""
        is_tie = (self.low >= -self.tie_margin) & (self.high <= self.tie_margin)
        leads = ((self.low > 0) | (self.high < 0)) & ~is_tie
        return (self.winner >= 0) & (self.runner_up >= 0) & ~leads

    @property
    def is_exhausted(self) -> NDArray[np.bool_]:
        """Where a longer deadline changes nothing: no larger budget was measured."""
        stays = (self.winner == self.winner[:, -1:]) & self.is_at_largest
        return np.logical_and.accumulate(stays[:, ::-1], axis=1)[:, ::-1]

    def table(self, every: int = 1) -> pd.DataFrame:
        """A row for each cell in which a method fits, of every so-manieth row and column."""
        sample, deadline = np.meshgrid(self.sample_ms, self.deadline_ms, indexing="ij")
        names = np.array([*self.methods, ""])  # -1 is the last
        columns = {
            "deadline_ms": deadline,
            "sample_ms": sample,
            "method": names[self.winner],
            "target_spp": self.spp,
            "is_largest_budget": self.is_at_largest,
            "runner_up": names[self.runner_up],
            "difference": self.difference,
            "low": self.low,
            "high": self.high,
            "is_open": self.is_open,
            "is_uncertain": self.is_uncertain,
        }
        cells = pd.DataFrame(
            {name: values[::every, ::every].ravel() for name, values in columns.items()}
        )
        return pd.DataFrame(cells[cells["method"] != ""].reset_index(drop=True))


def map_winners(curves: Sequence[Curve]) -> WinnerMap:
    """The winner, the runner-up and their difference for each deadline and cost of a sample."""
    costs = np.geomspace(*SAMPLE_MS, ROWS)
    shortest = min(float(curve.frame_ms(SAMPLE_MS[0]).min()) for curve in curves)
    longest = max(float(curve.frame_ms(SAMPLE_MS[1]).max()) for curve in curves)
    span = (max(shortest / 1.5, 1.0), min(longest * 1.5, LONGEST_MS))
    deadlines = np.geomspace(*span, COLUMNS)
    sample_ms, deadline_ms = (grid.ravel() for grid in np.meshgrid(costs, deadlines, indexing="ij"))
    winners = find_winners(curves, sample_ms, deadline_ms)
    mean, low, high = _differences(curves, winners)
    first = winners.first
    spp = np.take_along_axis(winners.spp, first[None], axis=0)[0]  # NOTHING reads the last: nan
    largest = np.array([curve.spp[-1] for curve in curves])[first]
    possible = find_possible_winners(curves, sample_ms, deadline_ms)
    shape = (ROWS, COLUMNS)
    return WinnerMap(
        methods=tuple(curve.method for curve in curves),
        sample_ms=costs,
        deadline_ms=deadlines,
        winner=first.reshape(shape),
        runner_up=winners.second.reshape(shape),
        spp=np.where(first == NOTHING, np.nan, spp).reshape(shape),
        is_at_largest=((first != NOTHING) & (spp == largest)).reshape(shape),
        difference=mean.reshape(shape),
        low=low.reshape(shape),
        high=high.reshape(shape),
        is_uncertain=(possible.sum(axis=0) > 1).reshape(shape),
    )


def _differences(curves: Sequence[Curve], winners: Winners) -> Numbers:
    """Mean, low and high [3 n] of the winner minus the runner-up; nan without a runner-up."""
    result = np.full((3, winners.order.shape[1]), np.nan)
    first, second = winners.first, winners.second
    for pair in np.unique(np.stack([first, second]), axis=1).T:
        if NOTHING in pair:
            continue
        (places,) = np.nonzero((first == pair[0]) & (second == pair[1]))
        budgets = np.stack([_rounded(curves[i], winners.spp[i, places]) for i in pair])
        known, where = np.unique(budgets, axis=1, return_inverse=True)
        units = curves[pair[0]].units_at(known[0]) - curves[pair[1]].units_at(known[1])
        ends = interval_ends(units.T, draws=MAP_DRAWS)
        result[:, places] = np.stack([units.mean(axis=1), *ends])[:, where.ravel()]
    return result


def _rounded(curve: Curve, spp: Numbers) -> Numbers:
    """Budgets to the nearest of few, so that equal comparisons are computed once."""
    positive = np.where(spp > 0, spp, 1.0)
    near = np.exp(np.round(np.log(positive) * ROUNDING) / ROUNDING)
    return np.where(spp > 0, near.clip(curve.spp[0], curve.spp[-1]), 0.0)


def _caption(scores: Scores, curves: Sequence[Curve]) -> str:
    sizes = sorted(set(scores.measured["size"]) - {""})
    at_size = f" at {', '.join(sizes)}" if sizes else ""
    missing = "".join(f"\n{line}." for line in methods_without_curve(scores, curves))
    missing += f"\n{scores.remark_on_times}".rstrip()
    return (
        f"Best mean {score_name(scores.metric)} over scenes, {describe_clips(scores.measured)}. "
        f"Frame time: G-buffer, as many samples as in the results + plan + allocate + denoise on "
        f"{scores.device_name}{at_size} + samples per pixel x cost of a sample. "
        "Between measured budgets scores are linear in log spp; none is extrapolated." + missing
    )


def method_colours(
    methods: Sequence[str], visible: Sequence[str]
) -> dict[str, tuple[float, float, float]]:
    """A colour for each visible method: its family's in the Pareto plot of `methods`.

    Further visible variants of a family are lighter.
    """
    styles = style.line_styles(methods)
    colours = {}
    for family in dict.fromkeys(family_of(method) for method in sorted(visible)):
        variants = [method for method in sorted(visible) if family_of(method) == family]
        whites = np.linspace(0, LIGHTEST * (1 - 1 / len(variants) ** 2), len(variants))
        for method, white in zip(variants, whites, strict=True):
            red, green, blue = (part + (1 - part) * white for part in to_rgb(styles[method].color))
            colours[method] = (red, green, blue)
    return colours


def draw_winner_map(
    winners: WinnerMap, caption: str, measured_ms: float, heading: str = ""
) -> Figure:
    """The figure: regions with their method's colour and name, a key at the right, a caption.

    `measured_ms` is the cost of a sample in the results, marked at the vertical axis; `heading`
    says on top what must be known first.
    """
    winners, colours = _merge_small_regions(winners)
    visible = list(colours)
    figure = Figure(figsize=(WIDTH, HEIGHT))
    longest = max(len(name) for name in [*visible, "tie or not resolved against"])
    right = 1 - (0.65 + LETTER_INCHES * longest) / WIDTH
    caption = style.wrap_lines(caption, CAPTION_LETTERS)
    lines = caption.count("\n") + 1
    bottom = (0.75 + 0.2 * lines) / HEIGHT
    axes = figure.add_axes((0.075, bottom, right - 0.075, 0.925 - bottom))
    _set_scales(axes, winners)
    _fill_regions(axes, winners, colours)
    _mark_rates(axes)
    _mark_cost(axes, measured_ms)
    _label_regions(axes, winners, colours)
    handles = _handles(colours, bool(winners.is_uncertain.any()))
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(right + 0.012, 0.935),
        frameon=False, fontsize=11, borderaxespad=0, handlelength=1.6, labelspacing=0.6,
    )  # fmt: skip
    figure.text(0.012, 0.985, heading, fontsize=11, color=style.BLACK, va="top")
    figure.text(0.012, 0.016, caption, fontsize=9.5, color=style.BLACK, va="bottom")
    return figure


def _merge_small_regions(winners: WinnerMap) -> tuple[WinnerMap, dict[str, Any]]:
    """The map with one region of all methods that have no name of their own, and its colours."""
    indices, counts = np.unique(winners.winner[winners.winner >= 0], return_counts=True)
    largest = sorted(zip(counts, indices, strict=True), reverse=True)[:MAX_NAMES]
    named = [index for count, index in largest if count >= MIN_AREA * counts.sum()]
    colours: dict[str, Any] = dict(
        method_colours(winners.methods, [winners.methods[index] for index in named])
    )
    if len(named) == len(indices):
        return winners, colours
    is_small = ~np.isin(winners.winner, [-1, *named])
    name = f"{len(indices) - len(named)} others"
    merged = np.where(is_small, len(winners.methods), winners.winner)
    return replace(winners, methods=(*winners.methods, name), winner=merged), {
        **colours,
        name: to_rgb(OTHERS_COLOUR),
    }


def _set_scales(axes: Axes, winners: WinnerMap) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(winners.deadline_ms[0], winners.deadline_ms[-1])
    axes.set_ylim(winners.sample_ms[0], winners.sample_ms[-1])
    for axis, subs in ((axes.xaxis, (1, 2, 5)), (axes.yaxis, (1,))):
        axis.set_major_locator(LogLocator(subs=subs, numticks=20))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(visible=False)
    axes.set_xlabel("deadline: time of a frame [ms]")
    axes.set_ylabel("cost of one sample per pixel [ms]")


def _fill_regions(axes: Axes, winners: WinnerMap, colours: dict[str, Any]) -> None:
    x, y, winner = winners.deadline_ms, winners.sample_ms, winners.winner
    palette = [NOTHING_COLOUR, *(colours.get(name, NOTHING_COLOUR) for name in winners.methods)]
    axes.pcolormesh(
        x, y, winner + 1, cmap=ListedColormap(palette), vmin=-0.5, vmax=len(palette) - 0.5,
        shading="nearest", rasterized=True, zorder=0,
    )  # fmt: skip
    if winners.is_uncertain.any():
        axes.contourf(
            x, y, winners.is_uncertain.astype(float), levels=[0.5, 1.5], colors="white",
            alpha=UNCERTAIN_WHITE, zorder=0.5,
        )  # fmt: skip
    if winners.is_open.any():
        hatched = axes.contourf(
            x, y, winners.is_open.astype(float), levels=[0.5, 1.5], colors="none", hatches=[HATCH],
            zorder=1,
        )  # fmt: skip
        hatched.set_edgecolor((1, 1, 1, 0.75))
        hatched.set_linewidth(0)
    for index in np.unique(winner):
        inside = (winner == index).astype(float)
        if inside.min() < inside.max():
            axes.contour(x, y, inside, levels=[0.5], colors="white", linewidths=1.2, zorder=2)
    exhausted = winners.is_exhausted.astype(float)
    if exhausted.min() < exhausted.max():
        axes.contour(
            x, y, exhausted, levels=[0.5], colors=style.BLACK, linewidths=1.4, linestyles=":",
            zorder=2.5,
        )  # fmt: skip


def _mark_rates(axes: Axes) -> None:
    """Name frame rates at the upper edge."""
    low, high = axes.get_xlim()
    for name, deadline in RATES.items():
        if low < deadline < high:
            axes.axvline(deadline, color=style.BLACK, lw=0.6, alpha=0.35, zorder=3)
            axes.text(
                deadline, 1.008, name, transform=axes.get_xaxis_transform(), ha="center",
                va="bottom", fontsize=10, color=style.BLACK,
            )  # fmt: skip


def _mark_cost(axes: Axes, measured_ms: float) -> None:
    low, high = axes.get_ylim()
    if low < measured_ms < high:
        axes.axhline(measured_ms, color=style.BLACK, lw=0.6, alpha=0.35, zorder=3)
        axes.text(
            0.006, measured_ms, "cost in these results", fontsize=9.5, va="bottom",
            transform=axes.get_yaxis_transform(), color=style.BLACK, zorder=4,
        )  # fmt: skip


def _label_regions(axes: Axes, winners: WinnerMap, colours: dict[str, Any]) -> None:
    """Write each name where the largest circle fits into its largest region, if that is wide.

    The name is vertical where it fits in no other way.
    """
    box = axes.get_position()
    rows, columns = winners.winner.shape
    cell = (HEIGHT * box.height / rows, WIDTH * box.width / columns)  # inches
    names = {-1: "no denoiser fits"} | dict(enumerate(winners.methods))
    for index in np.unique(winners.winner):
        inside, name = winners.winner == index, names[index]
        ratio = 4 / max(len(name), 4)  # a name needs more room along its line
        flat = _widest_place(inside, (cell[0], cell[1] * ratio))
        upright = _widest_place(inside, (cell[0] * ratio, cell[1]))
        is_flat = flat[0] >= LABEL_INCHES
        radius, row, column = flat if is_flat else upright
        if radius < LABEL_INCHES:
            continue
        reach = BOLD_LETTER_INCHES / 2 * len(name)  # the name must not leave the axes
        if is_flat:
            column = _keep_inside(column, reach / cell[1], columns)
        else:
            row = _keep_inside(row, reach / cell[0], rows)
        colour = colours.get(name, to_rgb(NOTHING_COLOUR))
        is_dark = math.sqrt(np.dot(np.square(colour), (0.299, 0.587, 0.114))) < 0.62
        axes.text(
            winners.deadline_ms[column], winners.sample_ms[row], name, ha="center", va="center",
            color="white" if is_dark else style.BLACK, fontsize=12, zorder=5,
            fontweight="bold" if index >= 0 else "normal",
            rotation=0 if is_flat else 90,
            path_effects=[withStroke(linewidth=3.5, foreground=colour)],
        )  # fmt: skip


def _keep_inside(position: int, reach: float, length: int) -> int:
    """The position nearest to a given one that is `reach` away from both ends."""
    return int(np.clip(position, math.ceil(reach), max(length - 1 - math.ceil(reach), 0)))


def _widest_place(inside: NDArray[np.bool_], cell: tuple[float, float]) -> tuple[float, int, int]:
    """Radius in inches, row and column of the largest circle; `cell`: height and width, inches."""
    depth = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=cell)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return float(depth[row, column]), int(row), int(column)


def _handles(colours: dict[str, Any], has_uncertain: bool) -> list[Any]:
    handles: list[Any] = [Patch(color=colour, label=name) for name, colour in colours.items()]
    if has_uncertain:
        handles.append(Patch(color="#D8D8D8", label="paler: times are uncertain,\nanother may win"))
    handles.append(
        Patch(
            facecolor="#9A9A9A",
            edgecolor="white",
            hatch=HATCH,
            linewidth=0,
            label="tie or not resolved against\nthe runner-up (95 % interval)",
        )  # fmt: skip
    )
    handles.append(Line2D([], [], color=style.BLACK, ls=":", lw=1.4, label=EXHAUSTED))
    return handles

"""A map of the best method: deadline against cost of a sample, hatched where it is not resolved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
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

from reports.analysis.method_names import family_of
from reports.layout import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MapLabels", "WinnerMap", "draw_winner_map", "method_colours"]

WIDTH, HEIGHT = 11.0, 6.6  # inches; the keys and the caption are in it
EXHAUSTED = "to the right, no larger\nbudget was measured"
NOTHING_COLOUR = "#F4F4F4"
HATCH = "///"
LIGHTEST = 0.68  # share of white in the colour of a family's last variant; the first has none
RATES = {"120 Hz": 1000 / 120, "60 Hz": 1000 / 60, "30 Hz": 1000 / 30, "10 Hz": 100, "1 Hz": 1000}
LABEL_INCHES = 0.13  # of the radius of the largest circle in a region, from which it is labelled
LETTER_INCHES = 0.088  # in the key


@dataclass(frozen=True, eq=False)
class WinnerMap:
    """Cells [costs deadlines] of the map; indices into `methods`, -1 where none fits."""

    methods: tuple[str, ...]
    sample_ms: NDArray[np.float64]  # [costs]
    deadline_ms: NDArray[np.float64]  # [deadlines]
    winner: NDArray[np.intp]
    runner_up: NDArray[np.intp]
    spp: NDArray[np.float64]  # of the winner
    is_at_largest: NDArray[np.bool_]  # the winner is at its largest measured budget
    difference: NDArray[np.float64]  # winner minus runner-up; nan without one
    low: NDArray[np.float64]  # of its interval
    high: NDArray[np.float64]
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
        }
        cells = pd.DataFrame(
            {name: values[::every, ::every].ravel() for name, values in columns.items()}
        )
        return pd.DataFrame(cells[cells["method"] != ""].reset_index(drop=True))


@dataclass(frozen=True)
class MapLabels:
    """The texts of the figure, and the cost of a sample in the results."""

    caption: str
    measured_ms: float  # marked at the vertical axis; nan: not known


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


def draw_winner_map(winners: WinnerMap, labels: MapLabels) -> Figure:
    """The figure: regions with their method's colour and name, a key at the right, a caption."""
    visible = [winners.methods[i] for i in np.unique(winners.winner) if i >= 0]
    colours = method_colours(winners.methods, visible)
    figure = Figure(figsize=(WIDTH, HEIGHT))
    longest = max(len(name) for name in [*visible, "tie or not resolved against"])
    right = 1 - (0.65 + LETTER_INCHES * longest) / WIDTH
    lines = labels.caption.count("\n") + 1
    bottom = (0.75 + 0.2 * lines) / HEIGHT
    axes = figure.add_axes((0.075, bottom, right - 0.075, 0.925 - bottom))
    _set_scales(axes, winners)
    _fill_regions(axes, winners, colours)
    _mark_rates(axes)
    _mark_cost(axes, labels.measured_ms)
    _label_regions(axes, winners, colours)
    figure.legend(
        handles=_handles(colours), loc="upper left", bbox_to_anchor=(right + 0.012, 0.935),
        frameon=False, fontsize=11, borderaxespad=0, handlelength=1.6, labelspacing=0.6,
    )  # fmt: skip
    figure.text(0.012, 0.016, labels.caption, fontsize=9.5, color=style.BLACK, va="bottom")
    return figure


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
    names = {-1: "no method fits"} | dict(enumerate(winners.methods))
    for index in np.unique(winners.winner):
        inside, name = winners.winner == index, names[index]
        ratio = 4 / max(len(name), 4)  # a name needs more room along its line
        flat = _widest_place(inside, (cell[0], cell[1] * ratio))
        upright = _widest_place(inside, (cell[0] * ratio, cell[1]))
        is_flat = flat[0] >= LABEL_INCHES
        radius, row, column = flat if is_flat else upright
        if radius < LABEL_INCHES:
            continue
        colour = colours.get(name, to_rgb(NOTHING_COLOUR))
        is_dark = math.sqrt(np.dot(np.square(colour), (0.299, 0.587, 0.114))) < 0.62
        axes.text(
            winners.deadline_ms[column], winners.sample_ms[row], name, ha="center", va="center",
            color="white" if is_dark else style.BLACK, fontsize=12, zorder=5,
            fontweight="bold" if index >= 0 else "normal",
            rotation=0 if is_flat else 90,
            path_effects=[withStroke(linewidth=3.5, foreground=colour)],
        )  # fmt: skip


def _widest_place(inside: NDArray[np.bool_], cell: tuple[float, float]) -> tuple[float, int, int]:
    """Radius in inches, row and column of the largest circle; `cell`: height and width, inches."""
    depth = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=cell)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return float(depth[row, column]), int(row), int(column)


def _handles(colours: dict[str, Any]) -> list[Any]:
    handles: list[Any] = [Patch(color=colour, label=name) for name, colour in colours.items()]
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

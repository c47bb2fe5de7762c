"""Panels of score against frame time: a curve per method, the dominated area grey, keys below."""

from __future__ import annotations

import math
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from reports.layout import style
from reports.layout.style import LineStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_PANELS", "OVERALL", "Labels", "draw_pareto"]

LOG_RATIO = 10.0  # values that span a larger factor get a logarithmic axis
WINDOW_DB = 10.0  # below the best score, that a panel shows
UNRELIABLE = "hollow: unreliable time"
MAX_PANELS = 8  # with more scenes, only their mean is drawn
WIDTH, HEIGHT = 13.0, 5.4  # inches; keys and caption come on top of the height
METHOD_KEY_WIDTH = 9.0  # inches
OVERALL = "mean of all scenes"
HEADING_LETTERS = 150  # in a line
DOMINATED, DOMINATED_COLOUR = "slower and worse than another", "#EFEFEF"


@dataclass(frozen=True)
class Labels:
    """The texts of the figure."""

    score: str  # name and unit
    direction: str  # "higher" or "lower" is better, or empty
    caption: str
    heading: str = ""  # above the panels


def draw_pareto(plotted: pd.DataFrame, labels: Labels) -> Figure:
    """The figure: the mean over scenes at the left, a panel per scene at the right, keys below.

    A single scene has the only panel. With more than MAX_PANELS scenes only their mean is drawn.
    """
    names = set(plotted["scene"])
    scenes = sorted(names - {OVERALL})
    single = scenes if len(scenes) <= MAX_PANELS else []
    scenes = [*names & {OVERALL}, *single] if len(scenes) > 1 else scenes
    styles = style.line_styles(plotted["method"])
    columns = _key_columns(styles)
    extra_lines = labels.caption.count("\n") - 1  # beyond two
    # inches for keys and caption
    footer = 1.25 + 0.17 * extra_lines + 0.27 * math.ceil((len(styles) + 2) / columns)
    figure = Figure(figsize=(WIDTH, HEIGHT + footer))
    heading = fill(labels.heading, HEADING_LETTERS)
    top = 0.95 - 0.035 * len(heading.splitlines())
    panels = _add_panels(figure, scenes, footer / (HEIGHT + footer), top)
    figure.text(0.012, 0.985, heading, fontsize=12, fontweight="bold", color=style.BLACK, va="top")
    sizes = _marker_areas(plotted["target_spp"])
    for scene, axes in panels.items():
        points = plotted[plotted["scene"] == scene]
        _set_scales(axes, points, labels.direction)
        _shade_dominated(axes, points[points["front"]], labels.direction)
        _draw_curves(axes, points, styles, sizes)
        axes.set_title(scene, loc="left", fontweight="bold" if scene == OVERALL else "normal")
    better = f"  ({labels.direction} is better)" if labels.direction else ""
    panels[scenes[0]].set_ylabel(labels.score + better)
    has_unreliable = bool(plotted["unreliable"].any())
    _add_keys(figure, styles, sizes, columns, has_unreliable, (footer - 0.58) / (HEIGHT + footer))
    figure.text(0.012, 0.014, labels.caption, fontsize=10.5, color=style.BLACK, va="bottom")
    return figure


def _add_panels(figure: Figure, scenes: list[str], bottom: float, top: float) -> dict[str, Axes]:
    rows = 1 if len(scenes) <= 2 else 2
    columns = math.ceil((len(scenes) - 1) / rows)
    grid = figure.add_gridspec(
        rows, 1 + columns, width_ratios=[1.3 if columns > 1 else 1] + [0.85] * columns,
        left=0.075, right=0.988, top=top, bottom=bottom, wspace=0.17, hspace=0.3,
    )  # fmt: skip
    panels = {scenes[0]: figure.add_subplot(grid[:, 0])}
    for i, scene in enumerate(scenes[1:]):
        panels[scene] = figure.add_subplot(grid[i // columns, 1 + i % columns])
    for i, axes in enumerate(panels.values()):
        if i == 0 or i + columns >= len(scenes):
            axes.set_xlabel("frame time [ms]")
    return panels


def _set_scales(axes: Axes, points: pd.DataFrame, direction: str) -> None:
    """Set limits and scales: logarithmic for values that span decades, PSNR from 10 dB below best.

    Methods below that window are named at the lower edge.
    """
    low, high = points["value"].min(), points["value"].max()
    bottom = max(low, high - WINDOW_DB) if direction == "higher" else low
    times = points[points["value"] >= bottom]["frame_ms"]
    left, right = times.min(), times.max()
    if left > 0 and right / left > LOG_RATIO:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=20))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda ms, _: f"{ms:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(left / (right / left) ** 0.06, right * (right / left) ** 0.06)
    else:
        axes.set_xlim(left - 0.06 * (right - left or 1), right + 0.06 * (right - left or 1))
    if direction == "lower" and low > 0 and high / low > LOG_RATIO:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.3, high * 1.3)
        return
    margin = 0.07 * (high - bottom or 1)
    axes.set_ylim(bottom - margin, high + margin)
    style.note_hidden_points(axes, points, bottom - margin)


def _shade_dominated(axes: Axes, front: pd.DataFrame, direction: str) -> None:
    """Shade the area that is slower and worse than a point of the Pareto front, if there is one."""
    if front.empty:
        return
    front = front.sort_values("frame_ms")
    times = [*front["frame_ms"], axes.get_xlim()[1]]
    values = [*front["value"], front["value"].iloc[-1]]
    worst = axes.get_ylim()[1 if direction == "lower" else 0]
    axes.fill_between(times, values, worst, step="post", color=DOMINATED_COLOUR, lw=0, zorder=0.5)


def _draw_curves(
    axes: Axes, points: pd.DataFrame, styles: dict[str, LineStyle], sizes: dict[float, float]
) -> None:
    for method, curve in points.groupby("method"):
        line, curve = styles[str(method)], curve.sort_values("target_spp")
        axes.plot(curve["frame_ms"], curve["value"], c=line.color, ls=line.dash, lw=1.8, zorder=2)
        steady, unreliable = curve[~curve["unreliable"]], curve[curve["unreliable"]]
        axes.scatter(
            steady["frame_ms"], steady["value"], s=steady["target_spp"].map(sizes).tolist(),
            color=line.face, marker=line.marker, edgecolors=line.edge, linewidths=line.edge_width,
            zorder=3,
        )  # fmt: skip
        axes.scatter(
            unreliable["frame_ms"], unreliable["value"], marker=line.marker, facecolors="none",
            s=unreliable["target_spp"].map(sizes).tolist(), edgecolors=line.color, linewidths=1.1,
            linestyles=":", zorder=3,
        )  # fmt: skip


def _marker_areas(spp: pd.Series) -> dict[float, float]:
    """Marker area in square points for each budget, in equal steps from lowest to highest."""
    budgets = sorted(set(spp))
    return {spp: 26 + 95 * i / max(len(budgets) - 1, 1) for i, spp in enumerate(budgets)}


def _key_columns(styles: dict[str, LineStyle]) -> int:
    """Number of columns of the key of methods that fit beside the key of budgets."""
    inches = 0.85 + 0.1 * max(len(name) for name in styles)
    columns = int((METHOD_KEY_WIDTH - len(DOMINATED) * 0.1) / inches) + 1
    return max(1, min(len(styles) + 1, columns))


def _add_keys(
    figure: Figure,
    styles: dict[str, LineStyle],
    sizes: dict[float, float],
    columns: int,
    has_unreliable: bool,
    y: float,
) -> None:
    methods: list[Any] = [_method_handle(line, name) for name, line in styles.items()]
    methods.append(Patch(color=DOMINATED_COLOUR, label=DOMINATED))
    methods += [_unreliable_handle()] * has_unreliable
    budgets = [_budget_handle(size, f"{spp:g}") for spp, size in sizes.items()]
    shared: dict[str, Any] = {"frameon": False, "fontsize": 12, "borderaxespad": 0}
    figure.legend(
        handles=methods, loc="upper left", bbox_to_anchor=(0.012, y), columnspacing=1.4,
        ncol=columns, handlelength=2.8, handletextpad=0.5, **shared,
    )  # fmt: skip
    figure.legend(
        handles=budgets, loc="upper right", bbox_to_anchor=(0.99, y), columnspacing=0.8,
        ncol=len(budgets), handletextpad=0.1, title="samples per pixel", **shared,
    )  # fmt: skip


def _method_handle(line: LineStyle, name: str) -> Line2D:
    return Line2D(
        [], [], color=line.color, linestyle=line.dash, linewidth=1.8, marker=line.marker,
        label=name, markersize=8, markerfacecolor=line.face, markeredgecolor=line.edge,
    )  # fmt: skip


def _unreliable_handle() -> Line2D:
    return Line2D(
        [], [], linestyle="", marker="o", markersize=8, markerfacecolor="none",
        markeredgecolor=style.GREY, markeredgewidth=1.1, label=UNRELIABLE,
    )  # fmt: skip


def _budget_handle(area: float, name: str) -> Line2D:
    return Line2D(
        [], [], linestyle="", marker="o", color=style.GREY, markersize=math.sqrt(area),
        markeredgecolor="white", label=name,
    )  # fmt: skip

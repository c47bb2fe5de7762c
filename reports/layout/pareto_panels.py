"""Panels of error against time: curves over budgets, what is beaten in grey, keys below."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from reports.layout import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOG_FROM = 10.0  # what spans more than this factor stands on a logarithmic axis
WINDOW = 10.0  # dB below the best that a panel shows
MOST = 8  # scenes that have a panel each
WIDTH, HEIGHT = 13.0, 5.4  # inches; keys and caption come on top of the height
KEY_ROOM = 9.0  # inches of the width for the key of methods
OVERALL = "mean of all scenes"
FRONT, BEATEN = "another is faster and better", "#EFEFEF"


def draw(plotted: pd.DataFrame, texts: dict[str, str]) -> Figure:
    """The figure: the mean over scenes at the left, a panel a scene at the right, keys below.

    With one scene that is the only panel; with more than MOST, their mean is.
    """
    found = set(plotted["scene"])
    scenes = sorted(found - {OVERALL})
    single = scenes if len(scenes) <= MOST else []
    scenes = [*found & {OVERALL}, *single] if len(scenes) > 1 else scenes
    looks = style.line_styles(plotted["method"])
    columns = _columns(looks)
    lines = texts["caption"].count("\n") - 1  # of the caption, beyond two
    # inches for keys and caption
    room = 1.25 + 0.17 * lines + 0.27 * math.ceil((len(looks) + 1) / columns)
    figure = Figure(figsize=(WIDTH, HEIGHT + room))
    panels = _panels(figure, scenes, room / (HEIGHT + room))
    sizes = _sizes(plotted["target_spp"])
    for scene, axes in panels.items():
        points = plotted[plotted["scene"] == scene]
        _scale(axes, points, texts["better"])
        _beaten(axes, points[points["front"]], texts["better"])
        _panel(axes, points, looks, sizes)
        axes.set_title(scene, loc="left", fontweight="bold" if scene == OVERALL else "normal")
    panels[scenes[0]].set_ylabel(texts["value"] + texts["direction"])
    _keys(figure, looks, sizes, columns, (room - 0.58) / (HEIGHT + room))
    figure.text(0.012, 0.014, texts["caption"], fontsize=10.5, color=style.INK, va="bottom")
    return figure


def _panels(figure: Figure, scenes: list[str], bottom: float) -> dict[str, Axes]:
    rows = 1 if len(scenes) <= 2 else 2
    columns = math.ceil((len(scenes) - 1) / rows)
    grid = figure.add_gridspec(
        rows, 1 + columns, width_ratios=[1.3 if columns > 1 else 1] + [0.85] * columns,
        left=0.075, right=0.988, top=0.95, bottom=bottom, wspace=0.17, hspace=0.3,
    )  # fmt: skip
    panels = {scenes[0]: figure.add_subplot(grid[:, 0])}
    for i, scene in enumerate(scenes[1:]):
        panels[scene] = figure.add_subplot(grid[i // columns, 1 + i % columns])
    for i, axes in enumerate(panels.values()):
        if i == 0 or i + columns >= len(scenes):
            axes.set_xlabel("whole frame time [ms]")
    return panels


def _scale(axes: Axes, points: pd.DataFrame, better: str) -> None:
    """Axes that hold the points: logarithmic where they span decades, and PSNR from 10 dB below.

    A method that falls out of that window is named, with its range, at the lower edge.
    """
    low, high = points["value"].min(), points["value"].max()
    bottom = max(low, high - WINDOW) if better == "higher" else low
    seen = points[points["value"] >= bottom]["frame_ms"]
    left, right = seen.min(), seen.max()
    if left > 0 and right / left > LOG_FROM:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=20))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda ms, _: f"{ms:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(left / (right / left) ** 0.06, right * (right / left) ** 0.06)
    else:
        axes.set_xlim(left - 0.06 * (right - left or 1), right + 0.06 * (right - left or 1))
    if better == "lower" and low > 0 and high / low > LOG_FROM:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.3, high * 1.3)
        return
    margin = 0.07 * (high - bottom or 1)
    axes.set_ylim(bottom - margin, high + margin)
    style.name_below(axes, points, bottom - margin)


def _beaten(axes: Axes, best: pd.DataFrame, better: str) -> None:
    """Grey over all that is slower and worse than some point of the front."""
    best = best.sort_values("frame_ms")
    times = [*best["frame_ms"], axes.get_xlim()[1]]
    values = [*best["value"], best["value"].iloc[-1]]
    worst = axes.get_ylim()[1 if better == "lower" else 0]
    axes.fill_between(times, values, worst, step="post", color=BEATEN, lw=0, zorder=0.5)


def _panel(
    axes: Axes, points: pd.DataFrame, looks: dict[str, style.LineStyle], sizes: dict[float, float]
) -> None:
    for method, curve in points.groupby("method"):
        look, curve = looks[str(method)], curve.sort_values("target_spp")
        axes.plot(curve["frame_ms"], curve["value"], c=look.color, ls=look.dash, lw=1.8, zorder=2)
        axes.scatter(
            curve["frame_ms"], curve["value"], s=curve["target_spp"].map(sizes).tolist(), zorder=3,
            color=look.face, marker=look.marker, edgecolors=look.edge, linewidths=look.rim,
        )  # fmt: skip


def _sizes(spp: pd.Series) -> dict[float, float]:
    """Area of a marker in square points, in equal steps from the least budget to the largest."""
    budgets = sorted(set(spp))
    return {spp: 26 + 95 * i / max(len(budgets) - 1, 1) for i, spp in enumerate(budgets)}


def _columns(looks: dict[str, style.LineStyle]) -> int:
    """Columns of the key of methods that fit beside the key of budgets."""
    inches = 0.85 + 0.1 * max(len(name) for name in looks)
    return max(1, min(len(looks) + 1, int((KEY_ROOM - len(FRONT) * 0.1) / inches) + 1))


def _keys(
    figure: Figure,
    looks: dict[str, style.LineStyle],
    sizes: dict[float, float],
    columns: int,
    y: float,
) -> None:
    methods: list[Any] = [_line(look, name) for name, look in looks.items()]
    methods.append(Patch(color=BEATEN, label=FRONT))
    budgets = [_dot(size, f"{spp:g}") for spp, size in sizes.items()]
    shared: dict[str, Any] = {"frameon": False, "fontsize": 12, "borderaxespad": 0}
    figure.legend(
        handles=methods, loc="upper left", bbox_to_anchor=(0.012, y), columnspacing=1.4,
        ncol=columns, handlelength=2.8, handletextpad=0.5, **shared,
    )  # fmt: skip
    figure.legend(
        handles=budgets, loc="upper right", bbox_to_anchor=(0.99, y), columnspacing=0.8,
        ncol=len(budgets), handletextpad=0.1, title="samples per pixel", **shared,
    )  # fmt: skip


def _line(look: style.LineStyle, name: str) -> Line2D:
    return Line2D(
        [], [], color=look.color, linestyle=look.dash, linewidth=1.8, marker=look.marker,
        label=name, markersize=8, markerfacecolor=look.face, markeredgecolor=look.edge,
    )  # fmt: skip


def _dot(size: float, name: str) -> Line2D:
    return Line2D(
        [], [], linestyle="", marker="o", color=style.FAINT, markersize=math.sqrt(size),
        markeredgecolor="white", label=name,
    )  # fmt: skip

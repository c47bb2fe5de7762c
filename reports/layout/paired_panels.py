"""Two panels on one scale: curves as measured at the left, points of a paper at the right."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from reports.layout import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT = 13.0, 6.6  # inches; the caption comes on top of the height
WINDOW = 13.0  # dB below the best that a panel shows
LETTERS = 148  # of a line of the caption
MARKER, STAR = 7.5, 11.0  # points across; a star of the same width looks smaller
LABEL, LINE = 10.5, 0.205  # points of a label's letters, inches between two labels
LOG_FROM = 4.0  # what spans more than this factor stands on a logarithmic axis


@dataclass(frozen=True)
class Axis:
    """What the panels have from left to right."""

    column: str
    label: str
    doubling: bool = False  # a tick at each value that is there, doublings equally far apart


AXES = {
    "spp": Axis("target_spp", "samples per pixel", doubling=True),
    "time": Axis("frame_ms", "whole frame time [ms]"),
}


def draw(here: pd.DataFrame, theirs: pd.DataFrame, axis: Axis, caption: str) -> Figure:
    """The figure: curves with filled markers at the left, the paper's hollow ones at the right.

    Both have the columns method, spp, value and the axis' own; `theirs` also `derived`. A row has
    one colour and marker in both panels, and its name at the right of its last point.
    """
    looks = style.line_styles([*here["method"], *theirs["method"]])
    caption = "\n".join(fill(line, LETTERS) for line in caption.splitlines())
    room = 0.68 + 0.2 * (caption.count("\n") + 1)  # inches
    figure = Figure(figsize=(WIDTH, HEIGHT + room))
    left, right = figure.subplots(
        1, 2, width_ratios=[1.25, 1],
        gridspec_kw={
            "left": 0.06, "right": 0.875, "top": 0.95, "bottom": room / (HEIGHT + room),
            "wspace": 0.52,
        },
    )  # fmt: skip
    here, theirs = here.dropna(subset=[axis.column]), theirs.dropna(subset=[axis.column])
    span = max(_span(here["value"]), _span(theirs["value"]))
    for axes, points, title in ((left, here, "here"), (right, theirs, "published")):
        axes.set_title(title, loc="left", fontweight="bold")
        axes.set_xlabel(axis.label)
        if points.empty:
            axes.text(0.5, 0.5, "no times were measured", transform=axes.transAxes, ha="center")
            continue
        top = points["value"].max() + 0.05 * span
        low = top - 1.1 * span
        axes.set_ylim(low, top)
        style.name_below(axes, points, low)
        shown = points if axis.doubling else points[points["value"] > low]
        _scale(axes, shown[axis.column], axis)
    left.set_ylabel("PSNR [dB]  (up is better)")
    _curves(left, here, looks, axis)
    _points(right, theirs, looks, axis)
    figure.text(0.012, 0.014, caption, fontsize=10.5, color=style.INK, va="bottom")
    return figure


def _span(values: pd.Series[float]) -> float:
    return min(float(values.max() - values.min()), WINDOW) if len(values) else 1.0


def _scale(axes: Axes, values: pd.Series[float], axis: Axis) -> None:
    values = values[values > 0] if axis.doubling else values  # nothing has no place on this axis
    if values.empty:
        return
    least, most = values.min(), values.max()
    if axis.doubling or (least > 0 and most / least > LOG_FROM):
        axes.set_xscale("log")
        ratio = max(most / least, 2.0) ** 0.08
        axes.set_xlim(least / ratio, most * ratio)
        there = FixedLocator(sorted(set(values)))
        axes.xaxis.set_major_locator(
            there if axis.doubling else LogLocator(subs=(1, 2, 5), numticks=20)
        )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        if axis.doubling:
            axes.xaxis.set_minor_locator(NullLocator())
        return
    margin = 0.08 * (most - least or 1)
    axes.set_xlim(least - margin, most + margin)


def _curves(
    axes: Axes, points: pd.DataFrame, looks: dict[str, style.LineStyle], axis: Axis
) -> None:
    ends = []
    for method, curve in points.groupby("method"):
        look, curve = looks[str(method)], curve.sort_values("target_spp")
        x, y = curve[axis.column], curve["value"]
        axes.plot(
            x, y, c=look.color, ls=look.dash, lw=1.6, marker=look.marker, ms=_size(look),
            mfc=look.color, mec="white", mew=0.7, zorder=3,
        )  # fmt: skip
        ends.append((str(method), float(x.iloc[-1]), float(y.iloc[-1])))
    _names(axes, ends, looks, ".2f", hollow=False)


def _points(
    axes: Axes, points: pd.DataFrame, looks: dict[str, style.LineStyle], axis: Axis
) -> None:
    ends = []
    for method, curve in points.groupby("method"):
        look, curve = looks[str(method)], curve.sort_values("target_spp")
        x, y = curve[axis.column], curve["value"]
        axes.plot(x, y, c=look.color, ls=":", lw=1.4, zorder=2)
        axes.plot(
            x, y, c=look.color, ls="", marker=look.marker, ms=_size(look), mfc="white",
            mec=look.color, mew=1.6, zorder=3,
        )  # fmt: skip
        ends.append((str(method), float(x.iloc[-1]), float(y.iloc[-1])))
    _names(axes, ends, looks, ".1f", hollow=True)


def _names(
    axes: Axes,
    ends: list[tuple[str, float, float]],
    looks: dict[str, style.LineStyle],
    form: str,
    hollow: bool,
) -> None:
    """The name and last value of each curve at the right, none over another, thin lines to them."""
    if not ends:
        return
    low, high = axes.get_ylim()
    step = (high - low) * LINE / (0.93 * HEIGHT)  # of which the panels take so much
    ends = sorted(ends, key=lambda end: end[2])
    heights = spread_labels([max(low, value) for _, _, value in ends], step, low, high)
    for (method, x, value), height in zip(ends, heights, strict=True):
        look = looks[method]
        shown = max(low, value)
        axes.annotate(
            "", (x, shown), (1.025, height), xycoords="data",
            textcoords=axes.get_yaxis_transform(), annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": look.color, "alpha": 0.5, "lw": 0.7,
                        "shrinkA": 0, "shrinkB": 4, "zorder": 1},
        )  # fmt: skip
        axes.plot(
            [1.04], [height], transform=axes.get_yaxis_transform(), clip_on=False, ls="",
            marker=look.marker, ms=_size(look) - 1, c=look.color, mec=look.color,
            mfc="white" if hollow else look.color,
        )  # fmt: skip
        axes.text(
            1.062, height, f"{method} {value:{form}}", transform=axes.get_yaxis_transform(),
            va="center", fontsize=LABEL, color=look.color,
        )  # fmt: skip


def _size(look: style.LineStyle) -> float:
    return STAR if look.marker == "*" else MARKER


def spread_labels(heights: list[float], step: float, low: float, high: float) -> list[float]:
    """Rising heights moved as little as need be so that neighbours are `step` apart, in bounds.

    Where they do not all fit, they are evenly spread over the bounds.
    """
    count = len(heights)
    if (count - 1) * step >= high - low:
        return [low + (high - low) * i / max(count - 1, 1) for i in range(count)]
    # least squares under an order: what is too near is one block around its mean
    blocks: list[tuple[float, int]] = []  # mean of heights less their steps, and how many
    for i, height in enumerate(heights):
        mean, size = height - i * step, 1
        while blocks and blocks[-1][0] > mean:
            before, many = blocks.pop()
            mean, size = (mean * size + before * many) / (size + many), size + many
        blocks.append((mean, size))
    flat = [mean for mean, size in blocks for _ in range(size)]
    top = high - (count - 1) * step
    return [min(max(mean, low), top) + i * step for i, mean in enumerate(flat)]

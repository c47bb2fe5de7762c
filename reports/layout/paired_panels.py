"""Two panels with one dB scale: measured curves at the left, published points at the right."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from reports.analysis.rises import longest_rise
from reports.layout import style
from reports.layout.curve_labels import label_curves, marker_size
from reports.layout.style import LineStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["AXES", "Axis", "draw_pair"]

WIDTH, HEIGHT = 13.0, 6.6  # inches; the caption comes on top of the height
WINDOW_DB = 13.0  # below the best score, that a panel shows
CAPTION_LETTERS = 148  # in a line
LOG_RATIO = 4.0  # values that span a larger factor get a logarithmic axis


@dataclass(frozen=True)
class Axis:
    """The horizontal axis of both panels."""

    column: str
    label: str
    has_budget_ticks: bool = False  # logarithmic, with a tick at each budget


AXES = {
    "spp": Axis("target_spp", "samples per pixel", has_budget_ticks=True),
    "time": Axis("frame_ms", "frame time [ms]"),
}


def draw_pair(measured: pd.DataFrame, published: pd.DataFrame, axis: Axis, caption: str) -> Figure:
    """The figure: measured curves with filled markers, published points with hollow ones.

    Both tables have the columns method, target_spp, value and `axis.column`. A method has one
    colour and marker in both panels, and its name at the right of its last point.
    """
    styles = style.line_styles([*measured["method"], *published["method"]])
    caption = "\n".join(fill(line, CAPTION_LETTERS) for line in caption.splitlines())
    footer = 0.68 + 0.2 * (caption.count("\n") + 1)  # inches
    figure = Figure(figsize=(WIDTH, HEIGHT + footer))
    left, right = figure.subplots(
        1, 2, width_ratios=[1.25, 1],
        gridspec_kw={
            "left": 0.06, "right": 0.85, "top": 0.95, "bottom": footer / (HEIGHT + footer),
            "wspace": 0.62,
        },
    )  # fmt: skip
    measured = measured.dropna(subset=[axis.column])
    published = published.dropna(subset=[axis.column])
    span = max(_span_db(measured["value"]), _span_db(published["value"]))
    for axes, points, title in ((left, measured, "measured"), (right, published, "published")):
        axes.set_title(title, loc="left", fontweight="bold")
        axes.set_xlabel(axis.label)
        if points.empty:
            axes.text(0.5, 0.5, "no times were measured", transform=axes.transAxes, ha="center")
            continue
        high = points["value"].max() + 0.05 * span
        low = high - 1.1 * span
        axes.set_ylim(low, high)
        style.note_hidden_points(axes, points, low)
        visible = points if axis.has_budget_ticks else points[points["value"] > low]
        _set_time_or_budget_scale(axes, visible[axis.column], axis)
    left.set_ylabel("PSNR [dB]  (higher is better)")
    _draw_measured(left, measured, styles, axis)
    _draw_published(right, published, styles, axis)
    figure.text(0.012, 0.014, caption, fontsize=10.5, color=style.BLACK, va="bottom")
    return figure


def _span_db(values: pd.Series[float]) -> float:
    return min(float(values.max() - values.min()), WINDOW_DB) if len(values) else 1.0


def _set_time_or_budget_scale(axes: Axes, values: pd.Series[float], axis: Axis) -> None:
    values = values[values > 0] if axis.has_budget_ticks else values  # 0 has no logarithm
    if values.empty:
        return
    low, high = values.min(), values.max()
    if axis.has_budget_ticks or (low > 0 and high / low > LOG_RATIO):
        axes.set_xscale("log")
        ratio = max(high / low, 2.0) ** 0.08
        axes.set_xlim(low / ratio, high * ratio)
        axes.xaxis.set_major_locator(
            FixedLocator(sorted(set(values)))
            if axis.has_budget_ticks
            else LogLocator(subs=(1, 2, 5), numticks=20)
        )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        if axis.has_budget_ticks:
            axes.xaxis.set_minor_locator(NullLocator())
        return
    margin = 0.08 * (high - low or 1)
    axes.set_xlim(low - margin, high + margin)


def _draw_measured(
    axes: Axes, points: pd.DataFrame, styles: dict[str, LineStyle], axis: Axis
) -> None:
    ends = []
    for method, curve in points.groupby("method"):
        line, curve = styles[str(method)], curve.sort_values("target_spp")
        x, y = curve[axis.column], curve["value"]
        rise = longest_rise(list(x))
        axes.plot(x.iloc[rise], y.iloc[rise], c=line.color, ls=line.dash, lw=1.6, zorder=2)
        axes.plot(
            x, y, c=line.color, ls="", marker=line.marker, ms=marker_size(line), mfc=line.color,
            mec="white", mew=0.7, zorder=3,
        )  # fmt: skip
        ends.append((str(method), float(x.iloc[-1]), float(y.iloc[-1])))
    label_curves(axes, ends, styles, HEIGHT, ".2f", hollow=False)


def _draw_published(
    axes: Axes, points: pd.DataFrame, styles: dict[str, LineStyle], axis: Axis
) -> None:
    ends = []
    for method, curve in points.groupby("method"):
        line, curve = styles[str(method)], curve.sort_values("target_spp")
        x, y = curve[axis.column], curve["value"]
        axes.plot(x, y, c=line.color, ls=":", lw=1.4, zorder=2)
        axes.plot(
            x, y, c=line.color, ls="", marker=line.marker, ms=marker_size(line), mfc="white",
            mec=line.color, mew=1.6, zorder=3,
        )  # fmt: skip
        ends.append((str(method), float(x.iloc[-1]), float(y.iloc[-1])))
    label_curves(axes, ends, styles, HEIGHT, ".1f", hollow=True)

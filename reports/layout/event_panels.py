"""Curves of a score over the frames of clips, named at their ends, with the events marked."""

from __future__ import annotations

from math import ceil
from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from reports.layout import style
from reports.layout.curve_labels import LABEL_DISTANCE, LABEL_START, label_curves, label_width
from reports.layout.style import LineStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_PANELS", "draw_event_panels"]

MAX_PANELS = 6
COLUMNS = 2
WIDTH, PANEL = 13.0, 3.5  # inches: of the figure, height of a row of panels; more for many names
WINDOW_DB = 12.0  # methods that are always further below the best score are below the axis
LEFT, AXIS, EDGE = 0.72, 0.65, 0.12  # inches: of the first axis, of the others, at the right edge
CAPTION_LETTERS = 160  # in a line
NUMBER = ".1f"  # format of the last value of a curve


def draw_event_panels(curves: pd.DataFrame, events: pd.DataFrame, caption: str) -> Figure:
    """The figure. `curves` has the columns method, clip, frame, value; `events` clip, frame, event.

    The first MAX_PANELS clips of `events` are drawn.
    """
    clips = list(dict.fromkeys(events["clip"]))[:MAX_PANELS]
    styles = style.line_styles(curves["method"])
    caption = "\n".join(fill(line, CAPTION_LETTERS) for line in caption.splitlines())
    rows, columns = ceil(len(clips) / COLUMNS), min(len(clips), COLUMNS)
    footer = 0.75 + 0.2 * (caption.count("\n") + 1)
    panel = max(PANEL, LABEL_DISTANCE * 1.45 * len(styles))
    height = panel * rows + footer
    figure = Figure(figsize=(WIDTH, height))
    drawn = curves.loc[curves["clip"].isin(clips), ["method", "value"]]
    left, right, wspace = _place_columns(columns, label_width(drawn.to_numpy(), NUMBER))
    panels = figure.subplots(
        rows, columns, squeeze=False,
        gridspec_kw={"left": left, "right": right, "top": 1 - 0.4 / height,
                     "bottom": footer / height, "wspace": wspace, "hspace": 0.34},
    )  # fmt: skip
    for axes, clip in zip(panels.flat, clips, strict=False):
        part = curves[curves["clip"] == clip]
        _draw_panel(axes, part, events[events["clip"] == clip], styles)
        ends = part.sort_values("frame").groupby("method").last()
        names = [(str(row.Index), row.frame, row.value) for row in ends.itertuples()]
        label_curves(axes, names, styles, panel - 0.8, NUMBER)
        axes.set_title(clip, loc="left", fontweight="bold")
    for axes in panels.flat[len(clips) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("PSNR [dB]")
    for axes in panels[-1]:
        axes.set_xlabel("frame")
    figure.text(0.012, 0.1 / height, caption, fontsize=10.5, color=style.BLACK, va="bottom")
    return figure


def _place_columns(columns: int, labels: float) -> tuple[float, float, float]:
    """Left, right and wspace of columns of panels, each with `labels` inches at its right."""
    width = (WIDTH - LEFT - EDGE - columns * labels - (columns - 1) * AXIS) / columns / LABEL_START
    beside = (LABEL_START - 1) * width + labels  # a panel
    return LEFT / WIDTH, 1 - (beside + EDGE) / WIDTH, (beside + AXIS) / width


def _draw_panel(
    axes: Axes, curves: pd.DataFrame, events: pd.DataFrame, styles: dict[str, LineStyle]
) -> None:
    for method, line in styles.items():
        curve = curves[curves["method"] == method].sort_values("frame")
        axes.plot(
            curve["frame"], curve["value"], c=line.color, ls=line.dash, lw=1.5,
            marker=line.marker, ms=4.5, mfc=line.face, mec=line.color,
        )  # fmt: skip
    high = float(curves["value"].max())
    best = curves.groupby("method")["value"].transform("max")
    low = float(curves.loc[best > high - WINDOW_DB, "value"].min())  # shows how deep a curve falls
    margin = 0.06 * max(high - low, 1.0)
    axes.set_ylim(low - margin, high + 2.5 * margin)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.note_hidden_points(axes, curves, low - margin)
    for event in events.itertuples():
        position = float(str(event.frame)) - 0.5  # between the frames before and after
        axes.axvline(position, c=style.BLACK, ls="--", lw=1.0, zorder=1)
        axes.text(
            position, 0.985, f" {event.event}", transform=axes.get_xaxis_transform(), va="top",
            fontsize=10.5, color=style.BLACK,
        )  # fmt: skip

"""A waterfall: bars from one row's score to the next, with the interval of each step."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure

from reports.analysis.verdicts import LEADS, TRAILS
from reports.layout import style
from reports.layout.image_grid import add_caption

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_PANELS", "draw_steps"]

MAX_PANELS = 4
WIDTH, BAR, FOOTER = 13.0, 0.62, 1.25  # inches
NAMES = 3.1  # inches, for names of rows and what they add
RISE, FALL, PALE = "#0072B2", "#D55E00", 0.35  # Okabe and Ito 2008; opacity if not resolved
LETTERS = 46  # in a line of what a row adds


def draw_steps(steps: pd.DataFrame, texts: Mapping[str, str], caption: str) -> Figure:
    """The figure: a panel for each budget, the rows from top to bottom, the whole way at the end.

    `steps` is that of `measure_steps`, and `texts` says what each row adds.
    """
    budgets = sorted(set(steps["target_spp"]))[-MAX_PANELS:]
    single = steps[(steps["target_spp"] == budgets[0]) & (steps["step"] != "all")]
    rows = [single["before"].iloc[0], *single["method"]]
    height = BAR * (len(rows) + 1) + FOOTER + 0.4
    figure = Figure(figsize=(WIDTH, height))
    panels = figure.subplots(
        1, len(budgets), sharey=True, squeeze=False,
        gridspec_kw={"left": NAMES / WIDTH, "right": 0.985, "top": 1 - 0.4 / height,
                     "bottom": FOOTER / height, "wspace": 0.07},
    )[0]  # fmt: skip
    for axes, spp in zip(panels, budgets, strict=True):
        _draw_panel(axes, steps[steps["target_spp"] == spp], rows)
        axes.set_title(f"{spp:g} spp", loc="left", fontweight="bold")
        axes.set_xlabel("PSNR [dB]")
    labels = [f"{row}\n{fill(texts[row], LETTERS)}" for row in rows]
    panels[0].set_yticks(range(len(rows) + 1), [*labels, f"{rows[0]} to {rows[-1]}"], fontsize=9.5)
    panels[0].set_ylim(len(rows) + 0.5, -0.6)
    add_caption(figure, caption)
    return figure


def _draw_panel(axes: Axes, steps: pd.DataFrame, rows: list[str]) -> None:
    single, total = steps[steps["step"] != "all"], steps[steps["step"] == "all"]
    first = float(single["start"].iloc[0])
    axes.plot([first, first], [-0.35, 0.35], color=style.BLACK, lw=2.2)
    axes.annotate(f"{first:.2f}", (first, 0), (6, 0), textcoords="offset points", va="center",
                  fontsize=10)  # fmt: skip
    places = [rows.index(method) for method in single["method"]] + [len(rows)]
    records = [*single.to_dict("records"), *total.to_dict("records")]
    for place, row in zip(places, records, strict=True):
        start, end = float(row["start"]), float(row["value"])
        is_open = row["verdict"] not in (LEADS, TRAILS)
        colour = RISE if end >= start else FALL
        axes.barh(place, end - start, left=start, height=0.55, color=colour,
                  alpha=PALE if is_open else 1.0)  # fmt: skip
        if row["low"] == row["low"]:
            ends = [start + row["low"], start + row["high"]]
            axes.plot(ends, [place, place], color=style.BLACK, lw=1.1, marker="|", ms=6)
        right = max(start, end, start + row["high"] if row["high"] == row["high"] else end)
        axes.annotate(f"{row['difference']:+.2f}", (right, place), (6, 0), fontsize=10,
                      textcoords="offset points", va="center")  # fmt: skip
        if place < len(rows):
            axes.plot([start, start], [place - 1 + 0.28, place - 0.28], color=style.GREY, lw=0.8)
    axes.axhline(len(rows) - 0.5, color="#444444", lw=0.8)
    axes.margins(x=0.16)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")

"""Bars of networks by size: PSNR at equal frame time, and the samples that this time buys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from reports.analysis.network_sizes import BASE, nearest_budget
from reports.analysis.verdicts import LEADS, TRAILS
from reports.layout import style
from reports.layout.image_grid import add_caption
from reports.layout.tables import UNRELIABLE_MARK
from reports.published import published

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_PANELS", "draw_sizes"]

MAX_PANELS = 3  # of budgets; the samples are one more
WIDTH, BAR, FOOTER = 13.0, 0.5, 1.75  # inches
NAMES = 2.3  # inches, for names of rows and their sizes
RISE, FALL, PALE = "#0072B2", "#D55E00", 0.35  # Okabe and Ito 2008; opacity if not resolved
SAMPLES, PRINTED = "#B8B8B8", "#222222"
ROOM = 1.1  # of the bars' range, kept free at their right for numbers


def draw_sizes(latencies: pd.DataFrame, texts: Mapping[str, str], caption: str) -> Figure:
    """The figure: a panel for each `base_spp`, and one of the samples beside the published ones.

    `latencies` has the columns of `measure_sizes`, `texts` the size of the networks of each row.
    """
    methods = [row for row in texts if row in set(latencies["method"])]
    budgets = sorted(set(latencies["base_spp"]))
    height = BAR * len(methods) + FOOTER + 0.62
    figure = Figure(figsize=(WIDTH, height))
    panels = figure.subplots(
        1, len(budgets) + 1, sharey=True, squeeze=False,
        gridspec_kw={"left": NAMES / WIDTH, "right": 0.985, "top": 1 - 0.62 / height,
                     "bottom": FOOTER / height, "wspace": 0.09},
    )[0]  # fmt: skip
    for axes, spp in zip(panels, budgets, strict=False):
        part = latencies[latencies["base_spp"] == spp]
        _draw_differences(axes, _rows(part, methods))
        title = f"the time of {BASE}\nat {spp:g} spp: {part['deadline_ms'].iloc[0]:.3g} ms a frame"
        axes.set_title(title, loc="left", fontweight="bold", fontsize=11.5)
        axes.set_xlabel(f"PSNR minus {BASE} [dB]")
    spp = nearest_budget(budgets, published().network_study.rows[0].spp)
    _draw_samples(panels[-1], _rows(latencies[latencies["base_spp"] == spp], methods))
    panels[-1].set_title(
        f"samples at {spp:g} spp;\nbar: here; diamond: paper", loc="left",
        fontweight="bold", fontsize=11.5,
    )  # fmt: skip
    panels[-1].set_xlabel(f"share of those of {BASE}")
    labels = [f"{row}\n{texts[row]}" if texts[row] else row for row in methods]
    panels[0].set_yticks(range(len(methods)), labels, fontsize=9.5)
    panels[0].set_ylim(len(methods) - 0.4, -0.6)
    for axes in panels:
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.xaxis.set_major_locator(MaxNLocator(4))
    add_caption(figure, caption)
    return figure


def _rows(part: pd.DataFrame, methods: list[str]) -> list[tuple[int, dict[str, Any]]]:
    """Place and record of each row, from the top."""
    records: list[dict[str, Any]] = [dict(row) for _, row in part.iterrows()]
    return [(methods.index(row["method"]), row) for row in records]


def _draw_differences(axes: Axes, rows: list[tuple[int, dict[str, Any]]]) -> None:
    axes.axvline(0, color=style.BLACK, lw=1.0)
    ends = [0.0]
    for place, row in rows:
        if row["method"] == BASE:
            _write(axes, 0.0, place, f"{row['value']:.2f} dB, {row['spp']:g} spp")
            continue
        if row["spp"] != row["spp"]:
            _write(axes, 0.0, place, "no budget fits", style.GREY)
            continue
        value, low, high = row["difference"], row["low"], row["high"]
        alpha = 1.0 if row["verdict"] in (LEADS, TRAILS) else PALE
        axes.barh(place, value, height=0.6, color=RISE if value >= 0 else FALL, alpha=alpha)
        if low == low:
            axes.plot([low, high], [place] * 2, color=style.BLACK, lw=1.1, marker="|", ms=6)
        ends += [end for end in (value, low, high) if end == end]
        right = max(0.0, value, high if high == high else value)
        _write(axes, right, place, f"{value:+.2f}, {_format_spp(row)}")
    left, right = min(ends), max(ends)
    span = right - left or 1.0
    axes.set_xlim(left - 0.06 * span, right + ROOM * span)


def _draw_samples(axes: Axes, rows: list[tuple[int, dict[str, Any]]]) -> None:
    axes.axvline(1, color=style.BLACK, lw=1.0)
    ends = [1.0]
    for place, row in rows:
        here, printed = row["share"], row["paper_share"]
        if here == here:
            axes.barh(place, here, height=0.6, color=SAMPLES)
        if printed == printed:
            axes.plot([printed], [place], marker="D", ms=6, mfc="white", mec=PRINTED, mew=1.4)
        known = [number for number in (here, printed) if number == number]
        ends += known
        bound = ">=" * bool(row["is_bound"])
        ours = f"{bound}{here:.2f}" if here == here else "none"
        paper = f"{printed:.2f}" if printed == printed else "-"
        _write(axes, max(known, default=0.0), place, f"{ours}, paper {paper}")
    axes.set_xlim(0, max(ends) * (1 + ROOM))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:g}"))


def _format_spp(row: Mapping[str, Any]) -> str:
    mark = UNRELIABLE_MARK * bool(row["unreliable"])
    return f"{'>=' * bool(row['is_bound'])}{row['spp']:.3g} spp{mark}"


def _write(axes: Axes, x: float, place: int, text: str, colour: str = style.BLACK) -> None:
    axes.annotate(text, (x, place), (7, 0), textcoords="offset points", va="center", fontsize=9.5,
                  color=colour)  # fmt: skip

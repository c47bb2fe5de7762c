"""The frame-time figure: the parts of a frame of each method, stacked, a panel for each budget."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from reports.analysis.scores import FRAME_PARTS, Scores, metrics_with_values
from reports.layout import style
from reports.layout.page import Drawing, describe_clips, write_figures
from reports.layout.tables import uncertainty_of
from rlbench.benchmark.results import WIDE, MissingRowsError, interval_columns, mark_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_PANELS = 4
PALE = 0.45  # opacity of the bars of uncertain times
PARTS = {  # column: name and colour; the samplers warm, the denoiser blue, the renderer green, grey
    "gbuffer_ms": ("G-buffer", "#4D9221"),
    "plan_ms": ("plan", "#D55E00"),
    "allocate_ms": ("allocate", "#F0B27A"),
    "sampling_ms": ("sampling", "#6B6B6B"),
    "denoise_ms": ("denoise", "#0072B2"),
}
WIDTH, BAR, MARGIN = 13.0, 0.27, 0.75  # inches: of the figure, of a bar, above and below the bars
CAPTION_LETTERS = 165  # in a line


def write(results: pd.DataFrame, folder: Path, name: str = "frame-time") -> list[Path]:
    """Write the figure and a CSV of its numbers, see `write_figures`.

    With more than MAX_PANELS budgets the lowest, the highest and those between in equal steps are
    drawn; the CSV has all. Raises MissingRowsError if no method has a frame time.
    """
    files = write_figures(results, folder, name, _figures)
    if not files:
        raise MissingRowsError(
            "no method has a frame time on every scene. Measure times with rlbench run; its option "
            "--cost takes sample_ms from a published profile"
        )
    return files


def _figures(scores: Scores) -> dict[str, Drawing]:
    scores = replace(scores, metric=next(iter(metrics_with_values(scores.rows)), ""))
    times = frame_times(scores)
    if times.empty:
        return {}
    return {"": (partial(draw_frame_bars, _select_budgets(times), _caption(scores)), times)}


def frame_times(scores: Scores) -> pd.DataFrame:
    """The parts of a frame of each method and budget, mean over scenes; they add to `frame_ms`."""
    means = scores.overall
    columns = ["method", "target_spp", *FRAME_PARTS, *interval_columns("frame")]
    return means.loc[means["frame_ms"].notna(), columns].reset_index(drop=True)


def _select_budgets(times: pd.DataFrame) -> pd.DataFrame:
    budgets = sorted(set(times["target_spp"]))
    last, count = len(budgets) - 1, min(len(budgets), MAX_PANELS)
    chosen = [budgets[round(i * last / max(count - 1, 1))] for i in range(count)]
    return times[times["target_spp"].isin(chosen)]


def _caption(scores: Scores) -> str:
    lines = [
        f"Mean over scenes; {describe_clips(scores.measured)}. Plan, allocate and denoise on "
        f"{scores.device_name}.",
        f"Sampling: drawn samples per pixel x time of one sample per pixel "
        f"({scores.cost_source or 'not named'}). G-buffer: for methods that read one.",
        *(f"Two devices: {mix}." for mix in scores.device_mixes),
    ]
    return "\n".join(lines)


def draw_frame_bars(times: pd.DataFrame, caption: str) -> Figure:
    """The figure. `times` is as `frame_times` returns it.

    Methods are in the order of their mean frame time in all panels, the fastest on top. Bars of
    uncertain times are pale, with a line over the interval of the frame time.
    """
    methods = list(times.groupby("method")["frame_ms"].mean().sort_values().index)
    budgets = sorted(set(times["target_spp"]))
    caption = "\n".join(fill(line, CAPTION_LETTERS) for line in caption.splitlines())
    footer = 1.15 + 0.19 * (caption.count("\n") + 1)
    height = MARGIN + footer + BAR * len(methods)
    figure = Figure(figsize=(WIDTH, height))
    left = (0.35 + 0.085 * max(map(len, methods))) / WIDTH
    panels = figure.subplots(
        1, len(budgets), sharey=True, squeeze=False,
        gridspec_kw={"left": left, "right": 0.985, "top": 1 - 0.42 / height,
                     "bottom": footer / height, "wspace": 0.06},
    )[0]  # fmt: skip
    for axes, budget in zip(panels, budgets, strict=True):
        _draw_panel(axes, times[times["target_spp"] == budget], methods)
        axes.set_title(f"{budget:g} spp", loc="left", fontweight="bold")
        axes.set_xlabel("frame time [ms]")
    handles: list[Any] = [Patch(color=color, label=name) for name, color in PARTS.values()]
    if any(uncertainty_of(row) > WIDE for row in times.to_dict("records")):
        line = Line2D([], [], color=style.BLACK, lw=1.2, label="interval of an uncertain time")
        handles.append(line)
    figure.legend(
        handles=handles, loc="upper left", ncol=len(PARTS) + 1, frameon=False,
        bbox_to_anchor=(0.006, (footer - 0.55) / height), columnspacing=1.6, handlelength=1.4,
    )  # fmt: skip
    figure.text(0.012, 0.10 / height, caption, fontsize=10.5, color=style.BLACK, va="bottom")
    return figure


def _draw_panel(axes: Axes, times: pd.DataFrame, methods: list[str]) -> None:
    rows = {row["method"]: row for row in times.to_dict("records")}
    ends = [
        row["frame_high_ms" if uncertainty_of(row) > WIDE else "frame_ms"] for row in rows.values()
    ]
    longest = max(map(float, ends), default=0.0) or 1.0
    for position, method in enumerate(methods):
        if method not in rows:
            axes.text(0.01 * longest, position, "not measured", va="center", color=style.GREY,
                      fontsize=9.5)  # fmt: skip
            continue
        row, start = rows[method], 0.0
        share = uncertainty_of(row)
        alpha = PALE if share > WIDE else 1.0
        for column, (_, color) in PARTS.items():
            axes.barh(
                position, row[column], left=start, height=0.74, color=color, alpha=alpha,
                edgecolor="white", linewidth=0.6,
            )  # fmt: skip
            start += float(str(row[column]))
        if share > WIDE:
            high = float(str(row["frame_high_ms"]))
            axes.hlines(position, row["frame_low_ms"], high, color=style.BLACK, lw=1.2)
            start = high
        text = f"{row['frame_ms']:.3g}{mark_uncertainty(share)}"
        axes.text(start + 0.012 * longest, position, text, va="center", fontsize=10)
    axes.set_xlim(0, longest * 1.3)
    axes.set_ylim(len(methods) - 0.4, -0.6)
    axes.set_yticks(range(len(methods)), methods)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")

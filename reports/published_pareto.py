"""The paper's two figures measured again: PSNR against budget and against frame time.

Two panels have one dB scale: measured curves at the left, published points at the right.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from reports.analysis.scores import Scores
from reports.layout import style
from reports.layout.curve_labels import label_curves, longest_rise, marker_size
from reports.layout.page import Drawing, write_figures
from reports.layout.style import LineStyle
from reports.layout.tables import uncertainty_of
from reports.published import no_published_rows, published
from rlbench.benchmark.results import WIDE, MissingRowsError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = ["method", "target_spp", "value", "frame_ms"]
WIDTH, HEIGHT = 13.0, 6.6  # inches; the caption comes on top of the height
WINDOW_DB = 13.0  # below the best score, that a panel shows
CAPTION_LETTERS = 148  # in a line
LOG_RATIO = 4.0  # values that span a larger factor get a logarithmic axis


class Axis(NamedTuple):
    """The horizontal axis of both panels."""

    column: str
    label: str
    has_budget_ticks: bool = False  # logarithmic, with a tick at each budget


AXES = {
    "spp": Axis("target_spp", "samples per pixel", has_budget_ticks=True),
    "time": Axis("frame_ms", "frame time [ms]"),
}


def write(results: pd.DataFrame, folder: Path, name: str = "paper") -> list[Path]:
    """Write `name`-spp and `name`-time, and `name`-pareto.csv, see `write_figures`.

    Frame time = gbuffer + plan + allocate + sampling + denoise, as in the results; that of the
    paper = inference + spp x 26.3 ms. Methods that the paper does not have are named in the caption
    only. Raises MissingRowsError if no method of the paper was measured.
    """
    files = write_figures(results, folder, name, _figures)
    if not files:
        raise MissingRowsError(no_published_rows(results))
    return files


def _figures(scores: Scores) -> dict[str, Drawing]:
    here, paper = measured_points(scores), published_points()
    if here.empty:
        return {}
    points = pd.concat([here.assign(source="here"), paper.assign(source="paper")])
    missing = _missing_methods(scores, here)
    return {
        f"-{axis}": (partial(draw_pair, here, paper, AXES[axis], caption + missing), None)
        for axis, caption in _captions(scores, here).items()
    } | {"-pareto": (None, points)}


def measured_points(scores: Scores) -> pd.DataFrame:
    """Measured means over scenes of the paper's methods; columns as in COLUMNS."""
    means = scores.overall
    means = means[means["method"].map(lambda method: published().find(method) is not None)]
    return pd.DataFrame(means[COLUMNS].reset_index(drop=True))


def published_points() -> pd.DataFrame:
    """Published scores, with frame times by the paper's mean cost; COLUMNS and `derived`."""
    paper, records = published(), []
    for point in paper.points():
        row = paper.find(point.row)
        inference_ms = row.inference_ms if row else float("nan")
        frame_ms = inference_ms + point.spp * paper.sample_ms
        records.append((point.row, point.spp, point.psnr_db, frame_ms, point.derived))
    return pd.DataFrame(records, columns=[*COLUMNS, "derived"])


def _captions(scores: Scores, measured: pd.DataFrame) -> dict[str, str]:
    paper = published()
    caption = (
        f"Left: PSNR, {scores.convention}; mean over scenes.\n"
        f"Right: {paper.title}, {paper.source}; {paper.conditions}; "
        "points joined by a dotted line: one of them is derived from the text.\n"
        "The panels have the same dB per inch but no common zero: compare the order of the "
        "methods, not their values."
    )
    budgets = ", ".join(f"{spp:g}" for spp in sorted(set(measured["target_spp"])))
    times = (
        f"\nPoints of a curve, from left to right: {budgets} spp, where measured. Measured frame "
        f"time: plan + allocate + denoise on {scores.device_name} + G-buffer + drawn samples per "
        f"pixel x time of one sample per pixel ({_short_cost_source(scores.cost_source)}); "
        f"published: inference + spp x {paper.sample_ms:g} ms."
    )
    return {"spp": caption, "time": caption + times}


def _short_cost_source(source: str) -> str:
    """The source of the cost in few words; of the paper's profile, the device and the scaling."""
    author = published().title.partition(",")[0]
    if author in source:
        return f"{source.partition(',')[0]}, published, {source.rpartition(', ')[2]}"
    return f"{source or 'not measured'}; rlbench run --cost paper-2080ti uses the published cost"


def _missing_methods(scores: Scores, measured: pd.DataFrame) -> str:
    """Caption lines with the methods that have scores and are not drawn."""
    absent = sorted(set(scores.measured["method"]) - set(measured["method"]))
    untimed = sorted(set(measured.loc[measured["frame_ms"].isna(), "method"]))
    means = scores.overall[scores.overall["method"].isin(measured["method"])]
    doubted = {row["method"] for row in means.to_dict("records") if uncertainty_of(row) > WIDE}
    missing = {
        "Two devices": list(scores.device_mixes),
        "Uncertain times, measured on a busy machine": sorted(doubted),
        "Measured, but not in the paper or not on every scene": absent,
        "Without a time": untimed,
    }
    return "".join(f"\n{title}: {', '.join(names)}." for title, names in missing.items() if names)


def draw_pair(measured: pd.DataFrame, printed: pd.DataFrame, axis: Axis, caption: str) -> Figure:
    """The figure: measured curves with filled markers, published points with hollow ones.

    Both tables have the columns method, target_spp, value and `axis.column`. A method has one
    colour and marker in both panels, and its name at the right of its last point.
    """
    styles = style.line_styles([*measured["method"], *printed["method"]])
    caption = style.wrap_lines(caption, CAPTION_LETTERS)
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
    printed = printed.dropna(subset=[axis.column])
    span = max(_span_db(measured["value"]), _span_db(printed["value"]))
    for axes, points, title in ((left, measured, "measured"), (right, printed, "published")):
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
    _draw_curves(left, measured, styles, axis, is_measured=True)
    _draw_curves(right, printed, styles, axis, is_measured=False)
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


def _draw_curves(
    axes: Axes,
    points: pd.DataFrame,
    styles: dict[str, LineStyle],
    axis: Axis,
    is_measured: bool,
) -> None:
    """Measured curves, or published points with hollow markers and dotted lines."""
    ends = []
    for method, curve in points.groupby("method"):
        line, curve = styles[str(method)], curve.sort_values("target_spp")
        x, y = curve[axis.column], curve["value"]
        joined = longest_rise(list(x)) if is_measured else list(range(len(x)))
        dash, width = (line.dash, 1.6) if is_measured else (":", 1.4)
        axes.plot(x.iloc[joined], y.iloc[joined], c=line.color, ls=dash, lw=width, zorder=2)
        face, edge, edge_width = (
            (line.color, "white", 0.7) if is_measured else ("white", line.color, 1.6)
        )
        axes.plot(
            x, y, c=line.color, ls="", marker=line.marker, ms=marker_size(line), mfc=face,
            mec=edge, mew=edge_width, zorder=3,
        )  # fmt: skip
        ends.append((str(method), float(x.iloc[-1]), float(y.iloc[-1])))
    number = ".2f" if is_measured else ".1f"
    label_curves(axes, ends, styles, HEIGHT, number, hollow=not is_measured)

"""Recovery: how many frames the PSNR of a method stays low after a cut or a light change.

An event begins a span of frames, which ends at the next event or with the clip. The level of a
method after the event is its own mean PSNR over the last quarter of the span, at least LEVEL_FRAMES
frames. The frames to recover are those before the first whose PSNR is at most TOLERANCE_DB below
the level; a method that is there in the event's own frame needs 0. The loss is the level less the
PSNR of the event's frame.

Each method is compared with itself on the same shot, so a method without memory recovers at once,
but for what the picture's content changes. Where the level is first reached in the frames that
define it, the method may not have finished: its number is a lower bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from reports.analysis.intervals import INTERVAL_NOTE, mean_with_interval
from reports.analysis.scores import Scores
from reports.layout import style
from reports.layout.curve_labels import LABEL_DISTANCE, LABEL_START, label_curves, label_width
from reports.layout.page import Drawing, Section, describe_clips, write_figures, write_report
from reports.layout.style import LineStyle
from reports.layout.tables import Record, Table, pivot, rank_rows
from rlbench.benchmark.results import EVENT_PREFIX

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOLERANCE_DB = 0.5  # below the level, at which a method has recovered
LEVEL_FRAMES = 2  # fewest frames whose mean is a level
MIN_SPAN = 4  # fewest frames of a span that is measured: half of it may be the level
CURVE = ["method", "target_spp", "scene", "clip"]
FIGURE_SPP = 1.0  # the figure shows the budget that is nearest
TITLES = {"frames": "Frames to recover", "loss": "PSNR lost in the first frame [dB]"}
NOTE = (
    f"Brackets: {INTERVAL_NOTE}. The level is the method's own mean PSNR over the last quarter of "
    f"the frames before the next event or the end, at least {LEVEL_FRAMES}; a method has recovered "
    f"in the first frame that is at most {TOLERANCE_DB:g} dB below it. After `>=` some clips ended "
    "before the PSNR was steady."
)
EVENTS = {"cut": "a cut", "light": "a light change", "cut and light": "a cut with a light change"}
MAX_PANELS = 6
PANEL_COLUMNS = 2
WIDTH, PANEL = 13.0, 3.5  # inches: of the figure, height of a row of panels; more for many names
WINDOW_DB = 12.0  # methods that are always further below the best score are below the axis
LEFT, AXIS, EDGE = 0.72, 0.65, 0.12  # inches: of the first axis, of the others, at the right edge
CAPTION_LETTERS = 160  # in a line
NUMBER = ".1f"  # format of the last value of a curve


def write(results: pd.DataFrame, folder: Path, name: str = "recovery") -> list[Path]:
    """Write the page and a figure of PSNR by frame, see `write_report` and `write_figures`."""
    missing = (
        f"no clip has a cut or a light change with {MIN_SPAN} frames after it. Takes have: "
        "rlbench run --preset takes"
    )
    page = write_report(results, folder, name, "Recovery", _section, missing)
    return [*page, *write_figures(results, folder, name, _figures)]


def _section(scores: Scores) -> Section | None:
    recoveries = measure_recoveries(scores)
    if recoveries.empty:
        return None
    spans = find_spans(scores)
    left_out = [
        f"{span.clip}: {span.event} at frame {span.frame}, as the next event or the end is "
        f"{span.length} frames later; {MIN_SPAN} are needed"
        for span in spans[spans["length"] < MIN_SPAN].itertuples()
    ]
    lists = {"Left out": left_out, "Not run": scores.skip_reasons}
    return Section(scores.device, _tables(summarize(recoveries)), recoveries, lists)


def _figures(scores: Scores) -> dict[str, Drawing]:
    """The figure of one device: the clips with most events first."""
    if measure_recoveries(scores).empty:
        return {}
    spans, curves = find_spans(scores), scores.per_frame
    counts = spans.groupby("clip")["frame"].transform("size")
    order = spans.assign(count=-counts).sort_values(["count", "clip", "frame"])
    spp = min(set(curves["target_spp"]), key=lambda budget: (abs(budget - FIGURE_SPP), budget))
    clips = order["clip"].nunique()
    selection = f"{MAX_PANELS} of {clips} clips with events." if clips > MAX_PANELS else ""
    caption = (
        f"PSNR of each frame at {spp:g} spp, {describe_clips(scores.measured)}. Dashed: the first "
        f"frame after a cut or a light change. {selection}"
    ).strip()
    at_budget = curves[curves["target_spp"] == spp]
    return {"": (partial(draw_event_panels, at_budget, order, caption), None)}


class Recovery(NamedTuple):
    """What one event did to one method."""

    frames: int  # to recover
    loss: float  # dB below the level in the event's frame; negative where it is above
    level: float  # dB
    is_bound: bool  # `frames` is a lower bound


def measure_span(psnr: list[float]) -> Recovery:
    """The recovery in a span of at least MIN_SPAN frames, whose first is the event's.

    >>> measure_span([20.0, 23.0, 24.8, 25.0, 25.0, 25.0, 25.0, 25.0])
    Recovery(frames=2, loss=5.0, level=25.0, is_bound=False)
    """
    tail = max(LEVEL_FRAMES, len(psnr) // 4)
    level = sum(psnr[-tail:]) / tail
    frames = next(i for i, value in enumerate(psnr) if value >= level - TOLERANCE_DB)
    return Recovery(frames, level - psnr[0], level, frames >= len(psnr) - tail)


def find_events(rows: pd.DataFrame) -> pd.DataFrame:
    """Columns scene, clip, frame, event: each event of each clip once, in order.

    `event` is `cut`, `light`, or both joined by `and`, if one frame begins with both.
    """
    is_event = rows["metric"].str.startswith(EVENT_PREFIX)
    named = rows[is_event].assign(event=rows["metric"].str.removeprefix(EVENT_PREFIX))
    events = named.groupby(["scene", "clip", "frame"])["event"]
    return pd.DataFrame(events.agg(lambda names: " and ".join(sorted(set(names)))).reset_index())


def find_spans(scores: Scores) -> pd.DataFrame:
    """The events with the column `length`, the frames to the next event or to the clip's end."""
    events = find_events(scores.rows)
    ends = scores.measured.groupby("clip")["frame"].max() + 1
    last = events["clip"].map(ends).fillna(0)
    following = events.groupby("clip")["frame"].shift(-1)
    return events.assign(length=(following.fillna(last) - events["frame"]).astype(int))


def measure_recoveries(scores: Scores) -> pd.DataFrame:
    """One row for each method, budget and event, with the columns of `Recovery`.

    Further columns: method, target_spp, scene, clip, event, frame (of the event).
    """
    columns = [*CURVE, "event", "frame", *Recovery._fields]
    return pd.DataFrame(_measure(scores), columns=columns)


def _measure(scores: Scores) -> Iterator[tuple[object, ...]]:
    spans = find_spans(scores)
    spans = spans[spans["length"] >= MIN_SPAN]
    for key, curve in scores.per_frame.groupby(CURVE):
        psnr = curve.set_index("frame")["value"].sort_index()
        for span in spans[spans["clip"] == key[-1]].to_dict("records"):
            values = psnr.loc[span["frame"] : span["frame"] + span["length"] - 1].tolist()
            if len(values) == span["length"]:
                yield (*key, span["event"], span["frame"], *measure_span(values))


def summarize(recoveries: pd.DataFrame) -> pd.DataFrame:
    """Mean over scenes of frames and loss, with interval, by method, budget and kind of event.

    Frames are never negative, and so are the intervals of their means.
    Columns method, target_spp, event, column (frames or loss), mean, low, high, events, bounds.
    """
    records = []
    for (event, method, spp), group in recoveries.groupby(["event", "method", "target_spp"]):
        for column in TITLES:
            values = group[["scene", "clip"]].assign(value=group[column].astype(float))
            interval = mean_with_interval(values)
            low = max(interval.low, 0.0 if column == "frames" else -math.inf)
            records.append(
                {
                    **{"event": event, "method": method, "target_spp": spp, "column": column},
                    **{"mean": interval.mean, "low": low, "high": interval.high},
                    **{"events": len(group), "bounds": int(group["is_bound"].sum())},
                }
            )
    return pd.DataFrame(records)


def _tables(summary: pd.DataFrame) -> list[Table]:
    tables = []
    for (event, column), records in summary.groupby(["event", "column"], sort=False):
        header, rows = pivot(records, _format, rank_rows(records, "mean", "lower"))
        count = int(records["events"].max())
        caption = f"Mean over scenes, {count} event{'s' * (count != 1)}; the least first."
        title = f"{TITLES[str(column)]}, {EVENTS.get(str(event), event)}"
        tables.append(Table(title, caption, header, rows, NOTE))
    return tables


def _format(record: Record) -> str:
    bound = ">= " * (record["column"] == "frames" and record["bounds"] > 0)
    mean, low, high = (round(record[name], 1) + 0.0 for name in ("mean", "low", "high"))  # no -0.0
    return f"{bound}{mean:.1f}" if high != high else f"{bound}{mean:.1f} [{low:.1f}, {high:.1f}]"


def draw_event_panels(curves: pd.DataFrame, events: pd.DataFrame, caption: str) -> Figure:
    """The figure. `curves` has the columns method, clip, frame, value; `events` clip, frame, event.

    The first MAX_PANELS clips of `events` are drawn.
    """
    clips = list(dict.fromkeys(events["clip"]))[:MAX_PANELS]
    styles = style.line_styles(curves["method"])
    caption = style.wrap_lines(caption, CAPTION_LETTERS)
    rows, columns = math.ceil(len(clips) / PANEL_COLUMNS), min(len(clips), PANEL_COLUMNS)
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

"""Recovery: how many frames a method needs after a cut or a light change, and its curves."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, INTERVAL_NOTE, mean_with_interval
from reports.analysis.recovery import (
    LEVEL_FRAMES,
    MIN_SPAN,
    TOLERANCE_DB,
    find_spans,
    measure_recoveries,
)
from reports.layout import style
from reports.layout.event_panels import MAX_PANELS, draw_event_panels
from reports.layout.page import Section, describe_clips, write_page
from reports.layout.tables import Table, pivot_by_budget, rank_rows
from rlbench.benchmark.results import MissingRowsError

__all__ = ["summarize", "write"]

FIGURE_SPP = 1.0  # the figure shows the budget that is nearest
TITLES = {"frames": "Frames to recover", "loss": "PSNR lost in the first frame [dB]"}
NOTE = (
    f"Brackets: {INTERVAL_NOTE}. The level is the method's own mean PSNR over the last quarter of "
    f"the frames before the next event or the end, at least {LEVEL_FRAMES}; a method has recovered "
    f"in the first frame that is at most {TOLERANCE_DB:g} dB below it. After `>=` some clips ended "
    "before the PSNR was steady."
)
EVENTS = {"cut": "a cut", "light": "a light change", "cut and light": "a cut with a light change"}


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "recovery",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex, and a figure of PSNR by frame, one for each device.

    `seed` and `draws` are those of the bootstrap. Raises MissingRowsError if no clip has an event
    with enough frames after it.
    """
    devices, sections, files = split_by_device(results), [], []
    for device, rows in devices.items():
        check_comparable(rows)
        scores = Scores(rows, device=device)
        recoveries = measure_recoveries(scores)
        if recoveries.empty:
            continue
        tables = _tables(summarize(recoveries, seed, draws))
        lists = {"Left out": _left_out(scores), "Not run": scores.skip_reasons}
        sections.append(Section(device, tables, recoveries, lists))
        stem = name if len(devices) == 1 else f"{name}-{style.slug(device)}"
        with mpl.rc_context(style.RC):
            files += style.save_figure(_draw(scores), folder, stem)
    if not sections:
        raise MissingRowsError(
            f"no clip has a cut or a light change with {MIN_SPAN} frames after it. Takes have: "
            "rlbench run --preset takes. Where clips are older than the key "
            "`light_changes`, remove their clip.toml; rlbench render writes it and keeps the frames"
        )
    return [*write_page(folder, name, "Recovery", results, sections), *files]


def summarize(recoveries: pd.DataFrame, seed: int, draws: int) -> pd.DataFrame:
    """Mean over scenes of frames and loss, with interval, by method, budget and kind of event.

    Frames are never negative, and so are the intervals of their means.
    Columns method, target_spp, event, column (frames or loss), mean, low, high, events, bounds.
    """
    records = []
    for (event, method, spp), group in recoveries.groupby(["event", "method", "target_spp"]):
        for column in TITLES:
            values = group[["scene", "clip"]].assign(value=group[column].astype(float))
            interval = mean_with_interval(values, seed, draws)
            lowest = 0.0 if column == "frames" else -math.inf
            records.append(
                {
                    **{"event": event, "method": method, "target_spp": spp, "column": column},
                    **{
                        "mean": interval.mean,
                        "low": max(interval.low, lowest),
                        "high": interval.high,
                    },
                    **{"events": len(group), "bounds": int(group["is_bound"].sum())},
                }
            )
    return pd.DataFrame(records)


def _tables(summary: pd.DataFrame) -> list[Table]:
    tables = []
    for (event, column), records in summary.groupby(["event", "column"], sort=False):
        header, rows = pivot_by_budget(records, _format, rank_rows(records, "mean", "lower"))
        what = EVENTS.get(str(event), str(event))
        count = int(records["events"].max())
        caption = f"Mean over scenes, {count} event{'s' * (count != 1)}; the least first."
        title = f"{TITLES[str(column)]}, {what}"
        tables.append(Table(title, caption, ("method", *header[1:]), tuple(rows), NOTE))
    return tables


def _format(record: Mapping[Hashable, Any]) -> str:
    bound = ">= " * (record["column"] == "frames" and record["bounds"] > 0)
    mean, low, high = (round(record[name], 1) + 0.0 for name in ("mean", "low", "high"))  # no -0.0
    return f"{bound}{mean:.1f}" if high != high else f"{bound}{mean:.1f} [{low:.1f}, {high:.1f}]"


def _left_out(scores: Scores) -> list[str]:
    """The events that are not measured, one sentence each."""
    spans = find_spans(scores)
    return [
        f"{span.clip}: {span.event} at frame {span.frame}, as the next event or the end is "
        f"{span.length} frames later; {MIN_SPAN} are needed"
        for span in spans[spans["length"] < MIN_SPAN].itertuples()
    ]


def _draw(scores: Scores) -> Any:
    """The figure of one device: the clips with most events first."""
    spans, curves = find_spans(scores), scores.per_frame
    counts = spans.groupby("clip")["frame"].transform("size")
    order = spans.assign(count=-counts).sort_values(["count", "clip", "frame"])
    spp = min(set(curves["target_spp"]), key=lambda budget: (abs(budget - FIGURE_SPP), budget))
    clips = order["clip"].nunique()
    selection = f"{MAX_PANELS} of {clips} clips with events." if clips > MAX_PANELS else ""
    caption = (
        f"PSNR of each frame at {spp:g} spp, {describe_clips(scores.measured)}. Dashed: the first "
        f"frame after a cut or a light change. {selection}"
    )
    return draw_event_panels(curves[curves["target_spp"] == spp], order, caption.strip())

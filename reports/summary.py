"""The summary: scores and times by method and budget, intervals, and what was not run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from reports.analysis.differences import (
    ALL_SCENES,
    correct_by_holm,
    difference_notes,
    rank_methods,
)
from reports.analysis.rows import nearest_budget, remarks, skip_reasons
from reports.analysis.scores import HEADLINE, Scores, metrics_with_values
from reports.layout.page import Section, write_report
from reports.layout.tables import (
    UNCERTAIN_MEANING,
    Record,
    Table,
    format_ms,
    format_number,
    score_table,
)

TIME_COLUMNS = {
    "gbuffer_ms": "G-buffer",
    "plan_ms": "plan",
    "allocate_ms": "allocate",
    "sampling_ms": "sampling",
    "denoise_ms": "denoise",
    "frame_ms": "frame",
    "inference_ms": "inference",
    "inference_p95_ms": "inference p95",
}
MAX_SCENE_TABLES = 8  # of PSNR; more scenes are in the report `clips`
MAX_METHODS = 16  # on a page with every table; a page of more methods is brief
BRIEF = (*HEADLINE, "ms_ssim", "relmse_trimmed", "flicker")  # metrics of a brief page


def write(results: pd.DataFrame, folder: Path, name: str = "summary") -> list[Path]:
    """Write the page of scores and times, see `write_report`.

    With more than `MAX_METHODS` methods, the page has the metrics of `BRIEF` alone, no table for
    each scene, and the parts of a frame at one budget. The CSV has all scores.
    """
    return write_report(results, folder, name, "Summary", _section)


def _section(scores: Scores) -> Section:
    rows = scores.rows
    metrics = [replace(scores, metric=metric) for metric in metrics_with_values(rows)]
    is_brief = scores.measured["method"].nunique() > MAX_METHODS
    hidden = {each.metric for each in metrics if is_brief and each.metric not in BRIEF}
    ranked = [rank_methods(each) for each in metrics]
    records = correct_by_holm(pd.concat(ranked)) if ranked else pd.DataFrame()
    ranks = [records[records["metric"] == each.metric] for each in metrics]
    overall = [rank[rank["scene"] == ALL_SCENES] for rank in ranks]
    tables = [
        score_table(each, rank, f"{each.convention}. ")
        for each, rank in zip(metrics, overall, strict=True)
        if not _is_constant(rank) and each.metric not in hidden
    ]
    if metrics:
        tables += _time_tables(metrics[0], is_brief)
        tables += [] if is_brief else _scene_tables(metrics[0], ranks[0])
    lists = {
        "Differences": difference_notes(records) if ranked else [],
        "Equal for all": _constant_metrics(metrics, overall),
        "In the CSV alone": [", ".join([*sorted(hidden), "scores of each scene"])] * is_brief,
        "Not run": skip_reasons(rows),
        "Left out of the means": [line for each in metrics for line in each.incomplete_groups],
        "Uncertain times": scores.uncertain_times,
        "Remarks": remarks(rows),
    }
    return Section(scores.device, tables, records, lists)


def _time_cell(row: Record, column: str) -> str:
    """A time; those of a frame, of inference and of sampling have their uncertainty."""
    part = column.removesuffix("_ms")
    if part in ("frame", "inference", "sampling"):
        return format_ms(row, part, 2)
    return format_number(row[column], ".2f")


def _scene_tables(scores: Scores, rank: pd.DataFrame) -> list[Table]:
    if scores.measured["scene"].nunique() > MAX_SCENE_TABLES:
        return []
    scenes = rank.groupby("scene")
    return [score_table(scores, rows) for scene, rows in scenes if scene != ALL_SCENES]


def _is_constant(rank: pd.DataFrame) -> bool:
    """True if several methods have one value at all budgets."""
    return rank["method"].nunique() > 1 and rank["mean"].nunique() == 1


def _constant_metrics(metrics: Sequence[Scores], ranks: Sequence[pd.DataFrame]) -> list[str]:
    """A sentence in place of each table that would hold one number."""
    return [
        f"{scores.metric} ({scores.convention}): {rank['mean'].iloc[0]:g} "
        f"{scores.column_text('unit')}".rstrip()
        + f" for all {rank['method'].nunique()} methods"
        for scores, rank in zip(metrics, ranks, strict=True)
        if _is_constant(rank)
    ]


def _time_tables(scores: Scores, is_brief: bool) -> list[Table]:
    """The parts of a frame, the fastest frame of a budget first; no table without times.

    A brief page has the budget nearest to 1 spp.
    """
    if scores.overall["frame_ms"].isna().all():
        return []
    times = scores.overall.sort_values(["target_spp", "frame_ms", "method"])
    if is_brief:
        times = times[times["target_spp"] == nearest_budget(set(times["target_spp"]))]
    rows = tuple(
        (row["method"], f"{row['target_spp']:g}", f"{row['mean_spp']:.3g}")
        + tuple(_time_cell(row, column) for column in TIME_COLUMNS)
        for row in times.to_dict("records")
    )
    caption = (
        f"Plan, allocate and denoise on {scores.device_name}, means of the middle half of their "
        "frames; sampling = mean spp x time of one sample per pixel "
        f"({scores.cost_source or 'an unnamed source'}); frame = G-buffer + plan + allocate + "
        f"sampling + denoise; inference = plan + allocate + denoise. {UNCERTAIN_MEANING}."
    )
    caption += "".join(f" Two devices: {mix}." for mix in scores.device_mixes)
    header = ("method", "target spp", "mean spp", *TIME_COLUMNS.values())
    return [Table("frame time [ms], mean over scenes", caption, header, rows)]

"""The summary: every score and time by method and budget, intervals, and what was not run."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis import notes
from reports.analysis.aggregate import Scores, metrics_with_values
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.multiplicity import correct_by_holm, difference_notes
from reports.analysis.ranking import ALL_SCENES, rank_methods
from reports.analysis.time_notes import unreliable_times
from reports.layout.page import Section, write_page
from reports.layout.score_table import score_table
from reports.layout.tables import UNRELIABLE_MARK, UNRELIABLE_MEANING, Table, format_ms

__all__ = ["write"]

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
MAX_SCENE_TABLES = 8


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "summary",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    Up to eight scenes have a table of PSNR each. `seed` and `draws` are those of the bootstrap.
    Raises ReportError if a mean would mix rows that cannot be compared.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        metrics = [Scores(rows, metric, device) for metric in metrics_with_values(rows)]
        ranked = [rank_methods(scores, seed, draws) for scores in metrics]
        records = correct_by_holm(pd.concat(ranked)) if ranked else pd.DataFrame()
        ranks = [records[records["metric"] == scores.metric] for scores in metrics]
        overall = [rank[rank["scene"] == ALL_SCENES] for rank in ranks]
        tables = [
            score_table(scores, rank, f"{scores.convention}. ")
            for scores, rank in zip(metrics, overall, strict=True)
            if not _is_constant(rank)
        ]
        if metrics:
            tables += [*_time_tables(metrics[0]), *_scene_tables(metrics[0], ranks[0])]
        lists = {
            "Differences": difference_notes(records) if ranked else [],
            "Equal for all": _constant_metrics(metrics, overall),
            "Not run": notes.skip_reasons(rows),
            "Left out of the means": [x for scores in metrics for x in scores.incomplete_groups],
            "Unreliable times": unreliable_times(rows),
            "Remarks": notes.remarks(rows),
        }
        sections.append(Section(device, tables, records, lists))
    return write_page(folder, name, "Summary", results, sections)


def _scene_tables(scores: Scores, rank: pd.DataFrame) -> list[Table]:
    """A table for each scene; none where there are many, which the report `clips` has in one."""
    if scores.measured["scene"].nunique() > MAX_SCENE_TABLES:
        return []
    return [
        score_table(scores, rows) for scene, rows in rank.groupby("scene") if scene != ALL_SCENES
    ]


def _is_constant(rank: pd.DataFrame) -> bool:
    """Do all of several methods have one value at all budgets?"""
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


def _by_frame_time(times: pd.DataFrame) -> Sequence[Mapping[Hashable, Any]]:
    """The rows by budget, the fastest frame first."""
    return times.sort_values(["target_spp", "frame_ms", "method"]).to_dict("records")


def _time_tables(scores: Scores) -> list[Table]:
    if scores.overall["frame_ms"].isna().all():
        return []
    header = ("method", "target spp", "mean spp", *TIME_COLUMNS.values())
    rows = tuple(
        (row["method"], f"{row['target_spp']:g}", f"{row['mean_spp']:.3g}")
        + tuple(format_ms(row[c], row["unreliable"], 2) for c in TIME_COLUMNS)
        for row in _by_frame_time(scores.overall)
    )
    caption = (
        f"Plan, allocate and denoise on {scores.device_name}, means of the middle half of their "
        "frames; sampling = mean spp x time of one sample per pixel "
        f"({scores.cost_source or 'an unnamed source'}); frame = G-buffer + plan + allocate + "
        "sampling + denoise; inference = plan + allocate + denoise. "
        f"{UNRELIABLE_MARK}: {UNRELIABLE_MEANING}."
    )
    caption += "".join(f" Two devices: {mix}." for mix in scores.device_mixes)
    return [Table("frame time [ms], mean over scenes", caption, header, rows)]

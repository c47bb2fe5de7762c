"""Tables of methods at equal time: half the samples, deadlines, crossovers."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.curves import Curve
from reports.analysis.method_names import family_of
from reports.analysis.misses import has_late_scores
from reports.analysis.verdicts import VERDICT_NOTE
from reports.layout.tables import Bold, Table, format_difference
from reports.published import published

__all__ = ["by_column", "crossover_table", "deadline_table", "half_table"]

Record = Mapping[Hashable, Any]


def half_table(records: pd.DataFrame, base: Curve) -> Table:
    """`base` against the best rival with twice its samples, and the row that the paper prints."""
    rows: list[tuple[str, ...]] = [
        (
            f"{row['method']} at {row['spp']:g} spp",
            f"{row['rival']} at {row['rival_spp']:g} spp",
            format_difference(row),
            f"{row['frame_ms']:.1f}",
            f"{row['rival_ms']:.1f}",
            f"{row['speedup']:.2f}",
        )
        for row in records.to_dict("records")
    ]
    if rows and (printed := _published_row(base.method)):
        rows.append(printed)
    caption = (
        f"{base.method} against the best method of another family with twice its samples. PSNR in "
        "dB, paired by scene. "
        "Faster: frame time of the rival / that of the method. "
        f"Last row, where it is there: the numbers of {published().title}, at its cost of a sample."
    )
    header = ("method", "best rival", "difference", "ms", "rival ms", "faster")
    return Table("Half the samples", caption, header, tuple(rows), VERDICT_NOTE)


def _published_row(base: str) -> tuple[str, ...] | None:
    """The headline of the paper in the same columns; None for a base of another family."""
    paper, family = published(), family_of(base)
    points = [point for point in paper.points() if family_of(point.row) == family]
    half = next((point for point in points if 2 * point.spp == paper.spp), None)
    method = paper.find(half.row) if half else None
    if half is None or method is None:
        return None
    rivals = [row for row in paper.table if family_of(row.row) != family]
    rival = max(rivals, key=lambda row: row.psnr_db)
    frame_ms = method.inference_ms + half.spp * paper.sample_ms
    rival_ms = rival.inference_ms + paper.spp * paper.sample_ms
    return (
        f"paper: {method.name} at {half.spp:g} spp",
        f"{rival.name} at {paper.spp:g} spp",
        f"{half.psnr_db - rival.psnr_db:+.1f}",
        f"{frame_ms:.1f}",
        f"{rival_ms:.1f}",
        f"{rival_ms / frame_ms:.2f}",
    )


def deadline_table(records: pd.DataFrame, scores: Scores, sample_ms: float, late: bool) -> Table:
    """The score of each method within each deadline; `late`: that 95 % of its frames meet."""

    def cell(row: Record) -> str:
        text = f"{row['value']:.2f}"
        if row["best"]:
            return Bold(text)
        return f"{text} ({format_difference(row)})"

    percentile = "p95" if late else "mean of the middle half"
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes, of each method at its best spp whose "
        f"frame time is within the time at the top: plan + allocate + denoise ({percentile}, on "
        f"{scores.device_name}) + samples x {sample_ms:.3g} ms "
        f"({scores.cost_source or 'an unnamed source'}), mean over scenes. "
        "Between measured budgets linear in log spp; none is extrapolated. Parentheses: paired "
        "difference to the best. "
    )
    if late:
        caption += (
            "Frames whose inference takes longer than its p95, one in 20, are late and show "
            + (
                "the last image again: the PSNR is 0.95 psnr + 0.05 psnr_late."
                if has_late_scores(scores.rows)
                else "the last image again; these results lack its error (psnr_late), so it is "
                "not part of the PSNR here."
            )
        )
    title = "Quality at a deadline that 95 % of frames meet" if late else "Equal time"
    best_first = records.sort_values(["deadline_ms", "value"], ascending=False)["method"]
    table = by_column(
        title, caption, records, "deadline_ms", lambda ms: f"{ms:g} ms", cell, best_first
    )
    return replace(table, note=VERDICT_NOTE)


def crossover_table(records: pd.DataFrame) -> Table:
    """The frame time at which one method of a pair passes the other."""
    rows = tuple(
        (
            f"{row['method']} passes {row['other']}",
            f"{row['at_ms']:.1f}",
            _unresolved(row),
            f"{row['value']:.2f}",
            f"{row['spp']:.3g}",
            f"{row['other_spp']:.3g}",
        )
        for row in records.to_dict("records")
    )
    caption = (
        "Frame time from which one method of a pair has the higher PSNR, both at their best spp "
        "within that time; a pair without a row has one leader wherever both fit. Not resolved: "
        "the times around it at which the paired 95 % interval of their difference includes zero."
    )
    return Table(
        "Crossovers",
        caption,
        ("pair", "ms", "not resolved", "PSNR", "spp", "spp of the other"),
        rows,
    )


def _unresolved(row: Record) -> str:
    low, high = row["low_ms"], row["high_ms"]
    if low != low:
        return "-"
    start, end = ("" if x in (0, np.inf) else f"{x:.0f}" for x in (low, high))
    return f"{start} to {end}".strip() if start or end else "everywhere"


def by_column(
    title: str,
    caption: str,
    records: pd.DataFrame,
    column: str,
    heading: Callable[[float], str],
    cell: Callable[[Record], str],
    order: Iterable[str] = (),
) -> Table:
    """A row per method, in `order` or else by name, and a column per value of `column`."""
    if records.empty:
        return Table(title, caption, ("method",), ())
    values = sorted(set(records[column]))
    cells = {(row["method"], row[column]): cell(row) for row in records.to_dict("records")}
    rows = tuple(
        (method, *(cells.get((method, value), "-") for value in values))
        for method in dict.fromkeys([*order, *sorted(set(records["method"]))])
    )
    return Table(title, caption, ("method", *map(heading, values)), rows)

"""PSNR of every clip: methods on moving cameras, cuts and static views."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis.differences import (
    VERDICT_NOTE,
    correct_by_holm,
    difference_columns,
    difference_notes,
)
from reports.analysis.intervals import UNKNOWN
from reports.analysis.scores import Scores, mean_over_scenes
from reports.layout.page import Section, write_report
from reports.layout.tables import (
    Bold,
    Record,
    Table,
    format_difference,
    format_number,
    pivot,
    rank_rows,
)

BASE = "ours"  # the method that others are compared with; the best method if it was not measured
MAX_CLIPS = 16  # with tables of their own; more clips are in the CSV alone
MEANS = "PSNR [dB], mean over scenes"


def write(results: pd.DataFrame, folder: Path, name: str = "clips") -> list[Path]:
    """Write PSNR by method and budget, and of each clip, see `write_report`.

    The first table has the means over scenes, the second the difference of each method to `ours`
    (or to the best method if `ours` was not measured) and its interval. A table for each budget
    has the clips if they are at most `MAX_CLIPS`; the CSV has them always.
    """
    return write_report(results, folder, name, "PSNR by clip", _section)


def _section(scores: Scores) -> Section:
    means = mean_over_scenes(scores.scene_means)
    records = _differences(scores, means)
    clips = sorted(set(scores.clip_means["clip"]))
    budgets = sorted(set(scores.clip_means["target_spp"])) if len(clips) <= MAX_CLIPS else []
    lists = {
        "In the CSV alone": [] if budgets else [f"PSNR of each of {len(clips)} clips"],
        "Differences": difference_notes(records),
        "Not run": scores.skip_reasons,
        "Left out of the means": scores.incomplete_groups,
        "Remarks": scores.remarks,
    }
    tables = [
        _mean_table(scores, means),
        *_difference_tables(records),
        *(_clip_table(scores, means, spp) for spp in budgets),
    ]
    return Section(scores.device, tables, pd.concat([scores.clip_means, records]), lists)


def _differences(scores: Scores, means: pd.DataFrame) -> pd.DataFrame:
    """A record for each method and budget: its difference to BASE, or to the best without BASE."""
    records = []
    for spp, part in means.groupby("target_spp"):
        ranked = part.sort_values("value", ascending=False)["method"]
        base = BASE if BASE in set(ranked) else ranked.iloc[0]
        for method in ranked[ranked != base]:
            keys = {"method": method, "target_spp": spp, "base": base}
            records.append(keys | difference_columns(scores.gap(method, base, float(str(spp)))))
    columns = ["method", "target_spp", "base", *difference_columns(UNKNOWN)]
    return correct_by_holm(pd.DataFrame(records, columns=columns))


def _mean_table(scores: Scores, means: pd.DataFrame) -> Table:
    best = means.groupby("target_spp")["value"].transform("max")
    records = means.assign(is_best=means["value"] == best)

    def cell(row: Record) -> str:
        text = format_number(row["value"], ".2f")
        return Bold(text) if row["is_best"] else text

    header, rows = pivot(records, cell, rank_rows(records, "value"))
    return Table(MEANS, f"{scores.convention}. The best is bold.", header, rows)


def _difference_tables(records: pd.DataFrame) -> list[Table]:
    """One table for each base: that of `ours`, or of the best methods."""
    return [
        Table(
            f"PSNR [dB], minus {base}",
            "Mean over scenes, paired by frame.",
            *pivot(part, format_difference, rank_rows(part, "difference")),
            VERDICT_NOTE,
        )
        for base, part in records.groupby("base", sort=False)
    ]


def _clip_table(scores: Scores, means: pd.DataFrame, spp: float) -> Table:
    clip_means, overall = (part[part["target_spp"] == spp] for part in (scores.clip_means, means))
    # methods that lack a scene have no mean and come last
    ranked = overall.sort_values("value", ascending=False)["method"]
    methods = list(dict.fromkeys([*ranked, *clip_means["method"]]))
    clips = clip_means.pivot_table("value", ["scene", "clip"], "method").reindex(columns=methods)
    rows = tuple(
        (str(clip), *_format_scores(line)) for clip, line in clips.droplevel("scene").iterrows()
    )
    note = "Mean over frames, the best of a row bold."
    return Table(f"PSNR [dB] at {spp:g} spp", "", ("clip", *methods), rows, note)


def _format_scores(scores: pd.Series) -> list[str]:
    cells = [format_number(value, ".2f") for value in scores]
    best = scores.max()
    return [Bold(x) if value == best else x for x, value in zip(cells, scores, strict=True)]

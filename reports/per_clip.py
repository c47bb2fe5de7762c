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
from reports.layout.tables import Bold, Table, format_difference, format_number

BASE = "ours"  # the method that others are compared with; the best method if it was not measured


def write(results: pd.DataFrame, folder: Path, name: str = "clips") -> list[Path]:
    """Write PSNR of each clip, a table per budget, best methods first, see `write_report`.

    Each table ends with the mean over scenes, and with the difference of each method to `ours` (or
    to the best method if `ours` was not measured) and its interval.
    """
    return write_report(results, folder, name, "PSNR by clip", _section)


def _section(scores: Scores) -> Section:
    means = mean_over_scenes(scores.scene_means)
    records = _differences(scores, means)
    budgets = sorted(set(scores.clip_means["target_spp"]))
    lists = {
        "Differences": difference_notes(records),
        "Not run": scores.skip_reasons,
        "Left out of the means": scores.incomplete_groups,
        "Remarks": scores.remarks,
    }
    tables = [_clip_table(scores, means, records, spp) for spp in budgets]
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


def _clip_table(
    scores: Scores, means: pd.DataFrame, differences: pd.DataFrame, spp: float
) -> Table:
    clip_means, scene_means, records = (
        part[part["target_spp"] == spp] for part in (scores.clip_means, means, differences)
    )
    overall = scene_means.set_index("method")["value"].sort_values(ascending=False)
    # methods that lack a scene have no mean and come last
    methods = list(dict.fromkeys([*overall.index, *clip_means["method"]]))
    clips = clip_means.pivot_table("value", ["scene", "clip"], "method").reindex(columns=methods)
    cells = {row["method"]: format_difference(row) for row in records.to_dict("records")}
    base = next((m for m in overall.index if m not in cells), methods[0])
    rows = (
        *((str(clip), *_format_scores(line)) for clip, line in clips.droplevel("scene").iterrows()),
        ("mean over scenes", *_format_scores(overall.reindex(methods))),
        (f"minus {base}", *(cells.get(method, "-") for method in methods)),
    )
    note = (
        f"{scores.convention}; mean over frames, the best of a row bold. Last row: mean over "
        f"scenes of the difference to {base}, paired by frame. {VERDICT_NOTE}"
    )
    return Table(f"PSNR [dB] at {spp:g} spp", "", ("clip", *methods), rows, note)


def _format_scores(scores: pd.Series) -> list[str]:
    cells = [format_number(value, ".2f") for value in scores]
    best = scores.max()
    return [Bold(x) if value == best else x for x, value in zip(cells, scores, strict=True)]

"""The ablation tables: each variant of a family minus the row that it changes, pair by pair."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.method_names import family_of, only_label, without_label
from reports.analysis.multiplicity import correct_by_holm, difference_notes
from reports.analysis.variant_differences import (
    choose_family,
    config_changes,
    differences,
    families_with_scores,
    group_by_base,
)
from reports.analysis.verdicts import VERDICT_NOTE
from reports.layout.page import Section, write_page
from reports.layout.tables import (
    UNRELIABLE_MARK,
    UNRELIABLE_MEANING,
    Table,
    format_difference,
    format_ms,
    pivot_by_budget,
    rank_rows,
)
from reports.published import published

__all__ = ["write"]


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "ablation",
    family: str = "",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex of `family`, by default ours or that with most variants.

    A variant `family/part-change` is compared with `family/part` where that has scores.

    Rows METHOD@LABEL are left out, unless their families have no rows without a label and there is
    only one label: then these rows are compared, and the title names the label. Raises
    MissingRowsError if the family has scores of its main variant alone, and ReportError if a mean
    would mix rows that cannot be compared.
    """
    label = only_label(set(results["method"]))
    if label:
        results = results.assign(method=results["method"].map(without_label))
    parts = [Scores(rows, device=device) for device, rows in split_by_device(results).items()]
    family = choose_family(parts, family)
    sections = []
    for part in parts:
        rows = part.rows[part.rows["method"].map(family_of) == family]
        scores = Scores(rows, device=part.device)
        if not families_with_scores(scores).get(family):
            continue
        check_comparable(rows)
        groups = group_by_base([family, *families_with_scores(scores)[family]])
        parts_of_page = [differences(scores, *group, seed, draws) for group in groups.items()]
        records = correct_by_holm(pd.concat(parts_of_page, ignore_index=True))
        tables = [
            table
            for make_table in (_score_table, _time_table, _config_table)
            for base, part in records.groupby("base", sort=False)
            if (table := make_table(scores, part, str(base)))
        ]
        lists = _lists(scores, records, family, groups)
        sections.append(Section(part.device, tables, records, lists))
    title = f"Ablations of {family}" + (f", rows @{label}" if label else "")
    return write_page(folder, name, title, results, sections)


def _score_table(scores: Scores, records: pd.DataFrame, base: str) -> Table:
    paper = published()
    of_base = paper.find(base)
    header, rows = pivot_by_budget(records, format_difference, rank_rows(records, "difference"))
    caption = (
        f"PSNR in dB ({scores.convention}) of each variant minus that of {base}, paired by "
        "scene, clip, frame, budget and seed; mean over scenes. Another training would differ too. "
        f"{VERDICT_NOTE}"
    )
    printed = {row[0]: paper.find(row[0]) for row in rows}
    if of_base and any(printed.values()):
        header = (*header, f"paper, {paper.spp:g} spp")
        rows = [
            (*row, f"{p.psnr_db - of_base.psnr_db:+.1f}" if (p := printed[row[0]]) else "-")
            for row in rows
        ]
        caption += f" Paper: difference in {paper.source}, {paper.title}."
    return Table(f"PSNR minus that of {base}", caption, header, tuple(rows))


def _time_table(scores: Scores, records: pd.DataFrame, base: str) -> Table | None:
    """None if no time was measured."""
    if records["frame_ms"].isna().all():
        return None
    header, rows = pivot_by_budget(
        records,
        lambda row: format_ms(row["frame_ms"], row["unreliable"], sign="+"),
        rank_rows(records, "frame_ms", "lower"),
    )
    caption = (
        "Frame time in ms (G-buffer + plan + allocate + sampling + denoise) minus that of "
        f"{base}, mean over scenes, on {scores.device_name}. Networks are timed on one clip of "
        "each size, in interleaved rounds. Cost of a sample: "
        f"{scores.cost_source or 'not measured'}. "
        f"{UNRELIABLE_MARK}: {UNRELIABLE_MEANING}."
    )
    return Table(f"Frame time minus that of {base}", caption, header, tuple(rows))


def _config_table(scores: Scores, records: pd.DataFrame, base: str) -> Table:
    order = rank_rows(records, "difference")
    header, rows = pivot_by_budget(records, lambda row: str(row["pairs"]), order)
    lines = tuple((*row, config_changes(scores, row[0], base)) for row in rows)
    caption = (
        f"Settings that differ between the configs in the results, {base} -> variant; rlbench "
        "list methods shows the question that each variant answers. Numbers: pairs of scores."
    )
    return Table(f"Changed settings of {base}, and pairs", caption, (*header, "settings"), lines)


def _lists(
    scores: Scores, records: pd.DataFrame, family: str, groups: dict[str, list[str]]
) -> dict[str, list[str]]:
    rows: list[dict[str, Any]] = [dict(row) for _, row in records.iterrows()]
    unpaired = [
        "{method} at {target_spp:g} spp: {unpaired} scores without a partner, {pairs} pairs".format(
            **row
        )
        for row in rows
        if row["unpaired"]
    ]
    compared = {(row["method"], row["target_spp"]) for row in rows}
    missing = [
        f"{method} at {spp:g} spp: no score of it or of {base}"
        for base, methods in groups.items()
        for method in methods
        for spp in sorted(set(scores.measured["target_spp"]))
        if (method, spp) not in compared
    ]
    variants = set(records["method"])
    absent = [
        f"{p.name}, in rlbench {p.row}"
        for p in published().table
        if family_of(p.row) == family and p.row != family and p.row not in variants
    ]
    return {
        "Differences": difference_notes(records),
        "Scores without a partner": unpaired,
        "Not compared": missing,
        "Published variants that were not measured": absent,
        "Not run": scores.skip_reasons,
        "Unreliable times": scores.unreliable_times,
        "Remarks": scores.remarks,
    }

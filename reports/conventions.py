"""Does the ranking survive another convention? Scores and ranks, agreement, and pairs that swap."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.convention_ranks import (
    OF_RUNS,
    conventions_by_metric,
    describe_swaps,
    rank_agreement,
    rank_by_convention,
    swaps,
)
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.layout.page import Section, write_page
from reports.layout.tables import Bold, Table
from rlbench.benchmark.results import MissingRowsError

__all__ = ["write"]


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "conventions",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    `seed` and `draws` are those of the bootstrap. Raises MissingRowsError where no metric has two
    conventions, and ReportError where a mean would mix rows that cannot be compared.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        tables: list[Table] = []
        records, lists = [], {}
        for metric, names in conventions_by_metric(rows).items():
            scores = {convention: Scores(rows, row, device) for convention, row in names.items()}
            ranked = rank_by_convention(scores)
            if ranked.empty:
                continue
            agreement, swapped = rank_agreement(ranked), swaps(scores, ranked, seed, draws)
            for spp in sorted(set(ranked["target_spp"])):
                tables.append(_matrix(metric, scores, _at(ranked, spp), spp))
                tables += _agreement_table(metric, _at(agreement, spp), spp)
            lists[f"Pairs that swap in {metric}"] = describe_swaps(swapped)
            lists |= {f"Conventions of {metric}": _describe(scores)}
            kinds = {"scores": ranked, "tau": agreement, "swap": swapped}
            records += [part.assign(table=kind, metric=metric) for kind, part in kinds.items()]
        if tables:
            sections.append(Section(device, tables, pd.concat(records), lists))
    if not sections:
        raise MissingRowsError(
            "no metric has scores of the same methods under two conventions; keep images with "
            "`rlbench run --keep-images`, score them with `rlbench evaluate --convention "
            "srgb,hable,linear`, and report RESULTS/evaluated"
        )
    return write_page(folder, name, "Conventions", results, sections)


def _matrix(metric: str, scores: Mapping[str, Scores], ranked: pd.DataFrame, spp: float) -> Table:
    """A row for each method, the best under the convention of runs first."""
    first = next(iter(scores.values()))
    unit = f" [{first.column_text('unit')}]" if first.column_text("unit") else ""
    conventions = list(dict.fromkeys(ranked["convention"]))
    cells = {(row["method"], row["convention"]): row for row in ranked.to_dict("records")}
    methods = ranked[ranked["convention"] == conventions[0]].sort_values(["rank", "method"])
    rows = tuple(
        (method, *(_cell(cells[method, convention]) for convention in conventions))
        for method in methods["method"]
    )
    caption = f"{first.direction.capitalize()} is better."
    note = (
        "Mean over scenes and, in brackets, the rank among these methods; bold is best. "
        f"{OF_RUNS} is the convention of runs."
    )
    return Table(f"{metric}{unit} at {spp:g} spp", caption, ("method", *conventions), rows, note)


def _cell(row: Mapping[Hashable, Any]) -> str:
    text = f"{row['mean']:.4g} ({row['rank']})"
    return Bold(text) if row["rank"] == 1 else text


def _agreement_table(metric: str, agreement: pd.DataFrame, spp: float) -> list[Table]:
    """Kendall's tau of each pair of conventions, as the upper half of a matrix."""
    taus = {(row["convention"], row["other"]): row["tau"] for row in agreement.to_dict("records")}
    rows, columns = (list(dict.fromkeys(agreement[name])) for name in ("convention", "other"))
    cells = tuple(
        (row, *(f"{taus[row, other]:.2f}" if (row, other) in taus else "" for other in columns))
        for row in rows
    )
    note = "Kendall's tau-b between the means of two conventions: 1 is the same order."
    title = f"agreement of the order in {metric} at {spp:g} spp"
    return [Table(title, "", ("convention", *columns), cells, note)]


def _describe(scores: Mapping[str, Scores]) -> list[str]:
    return [f"{name}: {each.convention}" for name, each in scores.items()]


def _at(records: pd.DataFrame, spp: float) -> pd.DataFrame:
    return records[records["target_spp"] == spp]

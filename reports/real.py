"""Scenes by others: scores, first frames, blotches, and whether the order of our presets holds."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis.aggregate import HEADLINE, Scores, keep_first_frames
from reports.analysis.comparability import check_comparable, select_device, split_by_device
from reports.analysis.convention_ranks import (
    describe_swaps,
    rank_agreement,
    rank_by_convention,
    swaps,
)
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.multiplicity import correct_by_holm, difference_notes
from reports.analysis.ranking import ALL_SCENES, rank_methods
from reports.layout.page import Section, write_page
from reports.layout.score_table import score_table
from reports.layout.tables import Table, pivot_by_budget
from rlbench.benchmark.results import MissingRowsError

__all__ = ["write"]

PRESET = "real"
PSNR, DEBIASED = HEADLINE
METRICS = (PSNR, DEBIASED, "blotches")
FIRST = "PSNR of the first frame of each clip"
TITLES = ("PSNR", "PSNR without the noise of the references", "Blotches on smooth surfaces")


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = PRESET,
    against: Mapping[str, pd.DataFrame] | None = None,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    `against` are results of other presets by name; the order of the rows that both have is compared
    with that of `results`, on the same device if they have it. Pictures `name`-*.png in `folder`
    are shown. Raises MissingRowsError for results of other presets without `against` and for
    results without PSNR, and ReportError where a mean would mix rows that cannot be compared.
    """
    presets = sorted(set(results["preset"]))
    if PRESET not in presets and not against:
        raise MissingRowsError(
            f"the results are of preset {', '.join(presets) or 'none'}; measure scenes by others "
            f"with rlbench run --preset {PRESET}, or name results to compare with by --against"
        )
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        scores = [Scores(rows, metric, device) for metric in METRICS]
        if scores[0].measured.empty:
            raise MissingRowsError("the results have no psnr; rlbench run scores it")
        others = {key: _on_device(table, device) for key, table in (against or {}).items()}
        sections.append(_section(scores, others, seed, draws))
    files = write_page(folder, name, "Scenes by others", results, sections)
    pictures = [f"![{file.stem}]({file.name})\n" for file in sorted(folder.glob(f"{name}-*.png"))]
    if pictures:
        with files[0].open("a", encoding="utf-8") as page:
            page.write("\n".join(["\n## Images\n", *pictures]))
    return files


def _on_device(results: pd.DataFrame, device: str) -> pd.DataFrame:
    """The rows of a device, or of the only one. Raises ReportError where others are several."""
    parts = split_by_device(results)
    rows = parts[device] if device in parts else select_device(results, "")[0]
    check_comparable(rows)
    return rows


def _section(
    scores: Sequence[Scores], others: Mapping[str, pd.DataFrame], seed: int, draws: int
) -> Section:
    psnr = scores[0]
    tabled = dict(zip(TITLES, scores, strict=True))
    tabled[FIRST] = Scores(keep_first_frames(psnr.measured), PSNR, psnr.device)
    ranked = [rank_methods(each, seed, draws).assign(table=key) for key, each in tabled.items()]
    every = pd.concat(ranked)
    records = correct_by_holm(every[every["scene"] == ALL_SCENES])
    parts = {key: records[records["table"] == key] for key in tabled}
    tables = [
        score_table(each, parts[key], f"{each.convention}. ", key)
        for key, each in tabled.items()
        if len(parts[key])
    ]
    orders = list(_compare_orders(scores, others, seed, draws))
    if orders:
        tables.append(_agreement_table(pd.concat([taus for taus, _ in orders])))
    lists = {
        "Differences": difference_notes(records),
        "Pairs that swap": [line for _, swapped in orders for line in _describe(swapped)],
        "Not run": psnr.skip_reasons,
        "Left out of the means": [line for each in scores for line in each.incomplete_groups],
        "Remarks": psnr.remarks,
    }
    numbers = pd.concat([records, *(table for both in orders for table in both)])
    return Section(psnr.device, tables, numbers, lists)


def _compare_orders(
    scores: Sequence[Scores], others: Mapping[str, pd.DataFrame], seed: int, draws: int
) -> Iterator[tuple[pd.DataFrame, pd.DataFrame]]:
    """Agreement and swaps of each metric with each other preset that has rows and budgets of it."""
    for each in scores:
        for preset, table in others.items():
            pair = {PRESET: each, preset: Scores(table, each.metric)}
            if pair[preset].measured.empty or (ranked := rank_by_convention(pair)).empty:
                continue
            rows = ranked.groupby("target_spp")["method"].nunique().rename("rows")
            taus = rank_agreement(ranked).join(rows, on="target_spp")
            keys = {"metric": each.metric, "method": f"{each.metric}, {preset}"}
            swapped = swaps(pair, ranked, seed, draws)
            yield taus.assign(table="tau", **keys), swapped.assign(table="swap", **keys)


def _agreement_table(taus: pd.DataFrame) -> Table:
    order = list(dict.fromkeys(taus["method"]))
    header, rows = pivot_by_budget(taus, _format_tau, order)
    note = (
        "Kendall's tau-b between the means on these clips and on those of another preset: 1 is the "
        "same order, -1 the reverse; in brackets, the rows that both have at that budget."
    )
    header = ("metric, other preset", *header[1:])
    return Table("Agreement of the order with other presets", "", header, tuple(rows), note)


def _format_tau(row: Mapping[Hashable, Any]) -> str:
    return f"{row['tau']:.2f} ({row['rows']})" if row["rows"] > 1 else "-"


def _describe(swapped: pd.DataFrame) -> list[str]:
    """How many pairs swap places, and a sentence for each swap that is resolved on both presets."""
    if swapped.empty:
        return []
    total, *sentences = describe_swaps(swapped, "on", "presets")
    resolved = sentences[: int(swapped["is_resolved"].sum())]
    return [f"{swapped['method'].iloc[0]}: {text}" for text in (total, *resolved)]

"""Table 1 of the paper measured again: scores and times beside the published ones."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis import notes
from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.correlation import RankCorrelation, kendall_tau
from reports.analysis.intervals import (
    BOOTSTRAP_SAMPLES,
    UNKNOWN,
    mean_with_interval,
    pair,
)
from reports.analysis.method_names import label_of
from reports.analysis.multiplicity import correct_by_holm, difference_columns, difference_notes
from reports.analysis.verdicts import VERDICT_NOTE
from reports.layout.page import Section, write_page
from reports.layout.tables import (
    UNRELIABLE_MARK,
    UNRELIABLE_MEANING,
    Table,
    format_difference,
    format_ms,
)
from reports.published import no_published_rows, published

__all__ = ["compare_with_paper", "rank_correlation", "write"]

STRONG_DB = 2.0  # below the best of the paper; weaker rows are in order whatever the rest does

BASE = "ours"  # the method that all others are compared with
PAPER_BASE = "ours/latent"  # the same in the paper
METRIC = "psnr"
Record = Mapping[Hashable, Any]  # a row of `compare_with_paper`
WARNING = (
    "The paper's columns and ours cannot be compared with each other, only the order of their "
    "rows: scenes, resolution and device differ, and our samples are not display-referred."
)


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "table1",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    Raises MissingRowsError if no method of the paper's table was measured, and ReportError if a
    mean would mix rows that cannot be compared.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        # rows with a label ran with other weights or in another precision
        scores = Scores(rows[rows["method"].map(label_of) == ""], METRIC, device)
        records = compare_with_paper(scores, seed, draws)
        if not any(published().find(method) for method in records.get("method", ())):
            continue
        table = _table(scores, records, _orders_text(records, seed, draws))
        sections.append(Section(device, [table], records, _lists(scores, records, rows)))
    if not sections:
        raise no_published_rows(results, METRIC)
    title = f"Table 1 of {published().title}, measured again"
    return write_page(folder, name, title, results, sections)


def compare_with_paper(
    scores: Scores, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES
) -> pd.DataFrame:
    """The mean over scenes of each method and budget, and the published numbers beside it.

    `difference` is the mean of the paired differences to `ours` at that budget, `low` and `high`
    its interval; `inference_ms` is plan + allocate + denoise. Published numbers stand at the budget
    of the paper's table only.
    """
    means = scores.overall
    frames = scores.per_frame.merge(means[["method", "target_spp"]], on=["method", "target_spp"])
    parts = {key: part for key, part in frames.groupby(["method", "target_spp"])}
    records = []
    for row in means.to_dict("records"):
        method, spp, gap = row["method"], row["target_spp"], UNKNOWN
        if method != BASE and (BASE, spp) in parts:
            pairs = pair(parts[method, spp], parts[BASE, spp])
            gap = mean_with_interval(pairs, seed, draws)
        records.append(
            {
                "method": method,
                "target_spp": spp,
                METRIC: row["value"],
                **difference_columns(gap),
                "inference_ms": row["inference_ms"],
                "unreliable": row["unreliable"],
                **_published_columns(method, spp),
            }
        )
    return correct_by_holm(pd.DataFrame(records)) if records else pd.DataFrame()


def rank_correlation(
    records: pd.DataFrame,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
    within_db: float = math.inf,
) -> RankCorrelation:
    """Rank correlation of published and measured PSNR, over the rows that have both.

    `within_db` selects strong rows: those that the paper places at most so far below its best.
    """
    both = records[records["published_psnr"].notna()]
    both = both[both["published_psnr"] >= both["published_psnr"].max() - within_db]
    return kendall_tau(list(both["published_psnr"]), list(both[METRIC]), seed, draws)


def _published_columns(method: str, spp: float) -> dict[str, object]:
    row = published().find(method)
    at_budget = row is not None and spp == published().spp
    return {
        "published_name": row.name if row else "",
        "published_psnr": row.psnr_db if row and at_budget else math.nan,
        "published_ms": row.inference_ms if row and at_budget else math.nan,
    }


def _table(scores: Scores, records: pd.DataFrame, orders: str) -> Table:
    paper = published()
    budgets = sorted(set(records["target_spp"]))
    cells = {(row["method"], row["target_spp"]): row for row in records.to_dict("records")}
    rows = tuple(
        (
            method,
            *(_format_number(cells.get((method, spp)), METRIC, ".2f") for spp in budgets),
            _format_gap(cells.get((method, paper.spp))),
            _format_inference(cells.get((method, paper.spp))),
            *_published_cells(method),
        )
        for method in _in_published_order(records)
    )
    header = (
        "method",
        *(f"{spp:g} spp" for spp in budgets),
        f"minus {BASE} at {paper.spp:g} spp",
        "inference ms",
        f"paper, {paper.spp:g} spp",
        f"paper, minus {PAPER_BASE}",
        "paper, ms",
    )
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes; inference = plan + allocate + "
        f"denoise, on {scores.device_name}; {UNRELIABLE_MARK}: {UNRELIABLE_MEANING}. "
        f"{VERDICT_NOTE} Paper: {paper.title}, {paper.source}; {paper.conditions}. "
        f"{WARNING} " + orders
    )
    return Table(f"Table 1 of {paper.title}, measured and published", caption, header, rows)


def _published_cells(method: str) -> tuple[str, str, str]:
    row, base = published().find(method), published().find(PAPER_BASE)
    if row is None:
        return ("-", "-", "-")
    gap = f"{row.psnr_db - base.psnr_db:+.1f}" if base and row is not base else "-"
    return (f"{row.psnr_db:.1f}", gap, f"{row.inference_ms:.1f}")


def _orders_text(records: pd.DataFrame, seed: int, draws: int) -> str:
    """How far paper and measurement agree on the order of all rows, and of strong rows alone."""
    everything = rank_correlation(records, seed, draws)
    if math.isnan(everything.tau):
        return f"The orders were not compared: {everything.rows} rows are in both."
    text = f"Order of the {everything.rows} rows that are in both, at {published().spp:g} spp: "
    text += _correlation_text(everything)
    strong = rank_correlation(records, seed, draws, STRONG_DB)
    if not math.isnan(strong.tau) and strong.rows < everything.rows:
        text += (
            f"; of the {strong.rows} that the paper places within {STRONG_DB:g} dB of its best: "
        )
        text += _correlation_text(strong)
    return f"{text} (permutation tests)."


def _correlation_text(correlation: RankCorrelation) -> str:
    return f"Kendall's tau-b {correlation.tau:.2f}, p {correlation.p_value:.2g}"


def _in_published_order(records: pd.DataFrame) -> list[str]:
    """Methods in the order of the paper's table, then the others by name."""
    order = [row.row for row in published().table]
    methods = set(records["method"])
    return [row for row in order if row in methods] + sorted(methods - set(order))


def _format_number(row: Record | None, column: str, number_format: str) -> str:
    return "-" if row is None or pd.isna(row[column]) else format(row[column], number_format)


def _format_inference(row: Record | None) -> str:
    return "-" if row is None else format_ms(row["inference_ms"], row["unreliable"])


def _format_gap(row: Record | None) -> str:
    if row is None or pd.isna(row["difference"]):
        return "-"
    return format_difference(row)


def _lists(scores: Scores, records: pd.DataFrame, rows: pd.DataFrame) -> dict[str, list[str]]:
    paper, methods = published(), set(records["method"])
    missing = [] if BASE in methods else [f"differences: '{BASE}' was not measured on every scene"]
    if paper.spp not in set(records["target_spp"]):
        missing.append(f"{paper.spp:g} spp, the paper's budget")
    psnr = rows[rows["metric"] == METRIC]
    return {
        "Differences": difference_notes(records),
        "Published rows that were not measured": [
            f"{p.name}, in rlbench {p.row}" for p in paper.table if p.row not in methods
        ],
        "Not measured": missing,
        "Differences from the paper's rows": [
            f"{p.row}: {p.note}" for p in paper.table if p.note and p.row in methods
        ],
        "Left out of the means": scores.incomplete_groups,
        "Left out: other weights or precision": sorted({m for m in rows["method"] if label_of(m)}),
        "Not run": notes.skip_reasons(psnr),
        "Unreliable times": scores.unreliable_times,
        "Remarks": notes.remarks(psnr),
    }

"""Table 1 of the paper measured again: scores and times beside the published ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from reports.analysis.differences import (
    VERDICT_NOTE,
    correct_by_holm,
    difference_columns,
    difference_notes,
)
from reports.analysis.intervals import UNKNOWN
from reports.analysis.rows import label_of
from reports.analysis.scores import Scores
from reports.layout.page import Section, write_report
from reports.layout.tables import (
    UNCERTAIN_MEANING,
    Record,
    Table,
    format_difference,
    format_ms,
    format_number,
)
from reports.published import no_published_rows, published
from rlbench.benchmark.results import interval_columns

STRONG_DB = 2.0  # below the best of the paper; weaker rows are in order whatever the rest does
BASE = "ours"  # the method that all others are compared with
PAPER_BASE = "ours/latent"  # the same in the paper
MAX_PERMUTATIONS = 10_000  # all orders are counted if there are at most so many, else drawn
BATCH = 1_000  # orders that are in memory at once
WARNING = (
    "The paper's columns and ours cannot be compared with each other, only the order of their "
    "rows: scenes, resolution and device differ, and our samples are not display-referred."
)


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "table1",
    trained: Mapping[str, int] | None = None,
) -> list[Path]:
    """Write the page, see `write_report`; without a method of the paper MissingRowsError.

    `trained` is the number of frames that weights were trained on, by method; None leaves its
    column out.
    """
    title = f"Table 1 of {published().title}, measured again"
    missing = no_published_rows(results)
    return write_report(results, folder, name, title, partial(_section, trained=trained), missing)


def _section(everything: Scores, trained: Mapping[str, int] | None) -> Section | None:
    rows = everything.rows
    # rows with a label ran with other weights or in another precision
    scores = replace(everything, rows=rows[rows["method"].map(label_of) == ""])
    records = compare_with_paper(scores)
    if not any(published().find(method) for method in records.get("method", ())):
        return None
    paper, methods = published(), set(records["method"])
    missing = [] if BASE in methods else [f"differences: '{BASE}' was not measured on every scene"]
    if paper.spp not in set(records["target_spp"]):
        missing.append(f"{paper.spp:g} spp, the paper's budget")
    lists = {
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
        "Not run": everything.skip_reasons,
        "Uncertain times": scores.uncertain_times,
        "Remarks": everything.remarks,
    }
    return Section(scores.device, [_table(scores, records, trained)], records, lists)


def compare_with_paper(scores: Scores) -> pd.DataFrame:
    """The mean over scenes of each method and budget, and the published numbers beside it.

    `difference` is the mean of the paired differences to `ours` at that budget, `low` and `high`
    its interval; `inference_ms` is plan + allocate + denoise. Published numbers stand at the budget
    of the paper's table only.
    """
    means = scores.overall
    measured = set(zip(means["method"], means["target_spp"], strict=True))
    records = []
    for row in means.to_dict("records"):
        method, spp = row["method"], row["target_spp"]
        is_compared = method != BASE and (BASE, spp) in measured
        printed = published().find(method)
        at_budget = printed if spp == published().spp else None
        records.append(
            {
                "method": method,
                "target_spp": spp,
                "psnr": row["value"],
                **difference_columns(scores.gap(method, BASE, spp) if is_compared else UNKNOWN),
                **{column: row[column] for column in interval_columns("inference")},
                "published_name": printed.name if printed else "",
                "published_psnr": at_budget.psnr_db if at_budget else math.nan,
                "published_ms": at_budget.inference_ms if at_budget else math.nan,
            }
        )
    return correct_by_holm(pd.DataFrame(records)) if records else pd.DataFrame()


def _table(scores: Scores, records: pd.DataFrame, trained: Mapping[str, int] | None) -> Table:
    paper = published()
    budgets = sorted(set(records["target_spp"]))
    cells = {(row["method"], row["target_spp"]): row for row in records.to_dict("records")}
    psnr = {key: row["psnr"] for key, row in cells.items()}
    order = [row.row for row in paper.table]
    methods = set(records["method"])
    rows = tuple(
        (
            method,
            *(format_number(psnr.get((method, spp), math.nan), ".2f") for spp in budgets),
            *_difference_and_time(cells.get((method, paper.spp))),
            *([] if trained is None else [format_number(trained.get(method, math.nan), ",.0f")]),
            *_published_cells(method),
        )
        for method in [row for row in order if row in methods] + sorted(methods - set(order))
    )
    header = (
        "method",
        *(f"{spp:g} spp" for spp in budgets),
        f"minus {BASE} at {paper.spp:g} spp",
        "inference ms",
        *([] if trained is None else ["frames trained"]),
        f"paper, {paper.spp:g} spp",
        f"paper, minus {PAPER_BASE}",
        "paper, ms",
    )
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes; inference = plan + allocate + "
        f"denoise, on {scores.device_name}; {UNCERTAIN_MEANING}. "
        f"{VERDICT_NOTE} Paper: {paper.title}, {paper.source}; {paper.conditions}. "
        f"{WARNING} {_orders_text(records)}"
    )
    return Table(f"Table 1 of {paper.title}, measured and published", caption, header, rows)


def _difference_and_time(row: Record | None) -> tuple[str, str]:
    if row is None:
        return "-", "-"
    gap: str = "-" if pd.isna(row["difference"]) else format_difference(row)
    return gap, format_ms(row, "inference")


def _published_cells(method: str) -> tuple[str, str, str]:
    row, base = published().find(method), published().find(PAPER_BASE)
    if row is None:
        return "-", "-", "-"
    gap = f"{row.psnr_db - base.psnr_db:+.1f}" if base and row is not base else "-"
    return f"{row.psnr_db:.1f}", gap, f"{row.inference_ms:.1f}"


def _orders_text(records: pd.DataFrame) -> str:
    """How far paper and measurement agree on the order of all rows, and of strong rows alone."""
    everything = rank_correlation(records)
    if math.isnan(everything.tau):
        return f"The orders were not compared: {everything.rows} rows are in both."
    text = (
        f"Order of the {everything.rows} rows that are in both, at {published().spp:g} spp: "
        f"{everything}"
    )
    strong = rank_correlation(records, STRONG_DB)
    if not math.isnan(strong.tau) and strong.rows < everything.rows:
        best = f"the paper places within {STRONG_DB:g} dB of its best"
        text += f"; of the {strong.rows} that {best}: {strong}"
    return f"{text} (permutation tests)."


@dataclass(frozen=True)
class RankCorrelation:
    """Kendall's tau-b of two sets of scores and its p-value."""

    tau: float  # in [-1, 1]; nan with fewer than two rows, or where all scores of a set are equal
    p_value: float  # two-sided, of the permutation test, in (0, 1]
    rows: int

    def __str__(self) -> str:
        """For captions."""
        return f"Kendall's tau-b {self.tau:.2f}, p {self.p_value:.2g}"


def rank_correlation(records: pd.DataFrame, within_db: float = math.inf) -> RankCorrelation:
    """Rank correlation of published and measured PSNR, over the rows that have both.

    `within_db` selects strong rows: those that the paper places at most so far below its best.
    """
    both = records[records["published_psnr"].notna()]
    both = both[both["published_psnr"] >= both["published_psnr"].max() - within_db]
    return kendall_tau(list(both["published_psnr"]), list(both["psnr"]))


def kendall_tau(
    first: Sequence[float], second: Sequence[float], draws: int = MAX_PERMUTATIONS
) -> RankCorrelation:
    """Kendall's tau-b (Kendall 1945, The Treatment of Ties) of two scores of the same rows.

    The p-value is the share of orders of `second` whose tau is at least as far from zero: of all
    orders if there are at most `draws`, else of `draws` random orders and the given one, so that it
    is never zero (Phipson and Smyth 2010, Permutation P-values Should Never Be Zero).
    """
    count = len(first)
    tau = float(stats.kendalltau(first, second).statistic) if count > 1 else math.nan
    if math.isnan(tau):
        return RankCorrelation(math.nan, math.nan, count)
    signs = _difference_signs(np.asarray(first, float))

    def concordance(orders: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        """Distance of tau from zero, up to a factor that no order changes: a whole number."""
        pairs = _difference_signs(np.moveaxis(orders, axis, -1))
        distances: NDArray[np.float64] = np.abs(np.einsum("ij,...ij", signs, pairs))
        return distances

    # scipy's own two-sided p doubles one tail, which is another number where there are ties
    test = stats.permutation_test(
        (np.asarray(second, float),),
        concordance,
        permutation_type="pairings",
        alternative="greater",
        vectorized=True,
        n_resamples=draws,
        batch=BATCH,
        rng=np.random.default_rng(0),
    )
    return RankCorrelation(tau, float(test.pvalue), count)


def _difference_signs(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signs of the differences of all pairs, [... n n] of values [... n]."""
    signs: NDArray[np.float64] = np.sign(values[..., :, None] - values[..., None, :])
    return signs

"""Table 1 anew: scores and times as measured here, beside those that the paper states."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis import aggregate, method_names
from reports.analysis.correlation import Agreement, kendall_tau
from reports.analysis.intervals import DRAWS, INTERVAL_NOTE, UNKNOWN, interval, paired
from reports.layout import page
from reports.layout.tables import Grid, gap_text
from reports.published import lacking, published

BASE = "ours"  # the row that all others are held against, as the paper does
METRIC = "psnr"
Record = Mapping[Hashable, Any]  # a row of `compared`
WARNING = (
    "Columns of the paper and of this table cannot be compared with each other, only their orders: "
    "other scenes, another resolution and device, and samples that are not display-referred."
)


def write(
    table: pd.DataFrame, folder: Path, name: str = "table1", seed: int = 0, draws: int = DRAWS
) -> list[Path]:
    """`name`.md, .csv and .tex: a section for each device.

    Raises LacksError if no row of the paper's table was measured, and ReportError where rows would
    be averaged that must not be.
    """
    sections = []
    for device, rows in aggregate.by_device(table).items():
        aggregate.check(rows)
        found = compared(rows, seed, draws)
        if not any(published().of(method) for method in found.get("method", ())):
            continue  # another device has the paper's rows, or none has
        alike = orders(found, seed, draws)
        grid = _grid(rows, found, alike, device)
        sections.append(page.Section(device, [grid], found, _lists(rows, found)))
    if not sections:
        raise lacking(table, METRIC)
    heading = f"Table 1 of {published().title}, and ours"
    return page.write(folder, name, heading, table, sections)


def compared(table: pd.DataFrame, seed: int = 0, draws: int = DRAWS) -> pd.DataFrame:
    """A row for each method and budget: its mean over scenes, and what the paper states of it.

    `difference` is the mean of the paired differences to `ours` at that budget, `low` and `high`
    its interval; inference is plan and denoise, p50. What the paper
    states of its 4 spp stands at that budget alone. Rows of named weights are left out.
    """
    table = table[table["method"].map(method_names.weights) == ""]
    means = aggregate.overall(aggregate.points(table, METRIC))
    shots = aggregate.per_frame_scores(table, METRIC).merge(
        means[["method", "target_spp"]], on=["method", "target_spp"]
    )
    parts = {key: part for key, part in shots.groupby(["method", "target_spp"])}
    made = []
    for row in means.to_dict("records"):
        method, spp, gap = row["method"], row["target_spp"], UNKNOWN
        if method != BASE and (BASE, spp) in parts:
            gap = interval(paired(parts[method, spp], parts[BASE, spp]), seed, draws)
        made.append(
            {
                "method": method,
                "target_spp": spp,
                METRIC: row["value"],
                "difference": gap.mean,
                "low": gap.low,
                "high": gap.high,
                "inference_ms": row["plan_ms"] + row["denoise_ms"],
                **_stated(method, spp),
            }
        )
    return pd.DataFrame(made)


def orders(found: pd.DataFrame, seed: int = 0, draws: int = DRAWS) -> Agreement:
    """How alike the paper and this table order the rows that both have at 4 spp."""
    both = found[found["published_psnr"].notna()]
    return kendall_tau(list(both["published_psnr"]), list(both[METRIC]), seed, draws)


def _stated(method: str, spp: float) -> dict[str, object]:
    stated = published().of(method)
    here = stated is not None and spp == published().spp
    return {
        "published_name": stated.name if stated else "",
        "published_psnr": stated.psnr_db if stated and here else math.nan,
        "published_ms": stated.inference_ms if stated and here else math.nan,
    }


def _grid(table: pd.DataFrame, found: pd.DataFrame, alike: Agreement, device: str) -> Grid:
    at, budgets = published().spp, sorted(set(found["target_spp"]))
    cells = {(row["method"], row["target_spp"]): row for row in found.to_dict("records")}
    base = published().of(BASE)
    body = []
    for method in _order(found):
        stated, here = published().of(method), cells.get((method, at))
        body.append(
            (
                method,
                *(_number(cells.get((method, spp)), METRIC, ".2f") for spp in budgets),
                _gap(here),
                _number(here, "inference_ms", ".1f"),
                f"{stated.psnr_db:.1f}" if stated else "-",
                f"{stated.psnr_db - base.psnr_db:+.1f}"
                if stated and base and stated is not base
                else "-",
                f"{stated.inference_ms:.1f}" if stated else "-",
            )
        )
    head = (
        "method",
        *(f"{spp:g} spp" for spp in budgets),
        f"less {BASE} at {at:g} spp",
        "inference ms",
        f"paper, {at:g} spp",
        f"paper, less {BASE}",
        "paper, ms",
    )
    caption = (
        f"PSNR in dB ({aggregate.column_text(table, METRIC, 'convention')})"
        f", mean over scenes; inference = "
        f"plan + denoise, p50, on {device or 'a device not named'}. In brackets: {INTERVAL_NOTE} "
        f"of the paired difference; bold where it excludes zero. Paper: "
        f"{published().title}, {published().source}; {published().conditions}. {WARNING} "
        + _agreed(alike)
    )
    return Grid(f"Table 1 of {published().title}, and here", caption, head, tuple(body))


def _agreed(alike: Agreement) -> str:
    if math.isnan(alike.tau):
        return f"The orders were not compared: {alike.rows} rows are in both."
    return (
        f"Orders at {published().spp:g} spp of the {alike.rows} rows that are in both: Kendall's "
        f"tau-b {alike.tau:.2f}, p {alike.chance:.2g} by permutation."
    )


def _order(found: pd.DataFrame) -> list[str]:
    """Methods as the paper lists them, then the others by name."""
    listed = [stated.row for stated in published().table]
    there = set(found["method"])
    return [row for row in listed if row in there] + sorted(there - set(listed))


def _number(row: Record | None, column: str, form: str) -> str:
    return "-" if row is None or pd.isna(row[column]) else format(row[column], form)


def _gap(row: Record | None) -> str:
    if row is None or pd.isna(row["difference"]):
        return "-"
    return gap_text(row["difference"], row["low"], row["high"])


def _lists(table: pd.DataFrame, found: pd.DataFrame) -> dict[str, list[str]]:
    there = set(found["method"])
    named = sorted({m for m in table["method"] if method_names.weights(m)})
    absent = [f"{s.name}, here {s.row}" for s in published().table if s.row not in there]
    missing = [] if BASE in there else [f"differences: '{BASE}' was not measured on every scene"]
    if published().spp not in set(found["target_spp"]):
        missing.append(f"{published().spp:g} spp, the paper's budget")
    scored = table[table["metric"] == METRIC]
    return {
        "Rows of the paper that are not here": absent,
        "Not measured": missing,
        "Not quite the paper's": [
            f"{s.row}: {s.note}" for s in published().table if s.note and s.row in there
        ],
        "Left out of the means": aggregate.incomplete_groups(table, METRIC),
        "Left out, as they ran with named weights": named,
        "Not run": aggregate.reasons(scored),
        "Remarks": aggregate.remarks(scored),
    }

"""Scenes by others: scores, first frames, blotches, and whether the order of our presets holds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pandas as pd
from scipy import stats

from reports.analysis.differences import (
    ALL_SCENES,
    correct_by_holm,
    difference_notes,
    rank_methods,
)
from reports.analysis.intervals import INTERVAL_NOTE
from reports.analysis.rows import check_comparable, select_device, split_by_device
from reports.analysis.scores import HEADLINE, Scores, keep_first_frames, mean_over_scenes
from reports.layout.page import Section, write_report
from reports.layout.tables import Record, Table, pivot, score_table
from rlbench.benchmark.results import MissingRowsError

PRESET = "real"
METRICS = (*HEADLINE, "blotches")
FIRST = "PSNR of the first frame of each clip"
TITLES = ("PSNR", "PSNR without the noise of the references", "Blotches on smooth surfaces")


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = PRESET,
    against: Mapping[str, pd.DataFrame] | None = None,
) -> list[Path]:
    """Write the page of scenes by others, see `write_report`.

    `against` are results of other presets by name; the order of the rows that both have is compared
    with that of `results`, on the same device if they have it. Pictures `name`-*.png in `folder`
    are shown. Raises MissingRowsError for results of other presets without `against` and for
    results without PSNR.
    """
    presets = sorted(set(results["preset"]))
    if PRESET not in presets and not against:
        raise MissingRowsError(
            f"the results are of preset {', '.join(presets) or 'none'}; measure scenes by others "
            f"with rlbench run --preset {PRESET}, or name results to compare with by --against"
        )
    title = "Scores and the order of rows"
    files = write_report(results, folder, name, title, lambda s: _section(s, against or {}))
    pictures = [f"![{file.stem}]({file.name})\n" for file in sorted(folder.glob(f"{name}-*.png"))]
    if pictures:
        with files[0].open("a", encoding="utf-8") as page:
            page.write("\n".join(["\n## Images\n", *pictures]))
    return files


def _section(psnr: Scores, against: Mapping[str, pd.DataFrame]) -> Section:
    if psnr.measured.empty:
        raise MissingRowsError("the results have no psnr; rlbench run scores it")
    scores = [replace(psnr, metric=metric) for metric in METRICS]
    others = {key: _on_device(table, psnr.device) for key, table in against.items()}
    tabled = dict(zip(TITLES, scores, strict=True))
    tabled[FIRST] = replace(psnr, rows=keep_first_frames(psnr.measured))
    every = pd.concat([rank_methods(each).assign(table=key) for key, each in tabled.items()])
    records = correct_by_holm(every[every["scene"] == ALL_SCENES])
    parts = {key: records[records["table"] == key] for key in tabled}
    tables = [
        score_table(each, parts[key], f"{each.convention}. ", key)
        for key, each in tabled.items()
        if len(parts[key])
    ]
    orders = list(_compare_orders(scores, others))
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


def _on_device(results: pd.DataFrame, device: str) -> pd.DataFrame:
    """The rows of a device, or of the only one. Raises ReportError where others are several."""
    parts = split_by_device(results)
    rows = parts[device] if device in parts else select_device(results, "")[0]
    check_comparable(rows)
    return rows


def _compare_orders(
    scores: Sequence[Scores], others: Mapping[str, pd.DataFrame]
) -> Iterator[tuple[pd.DataFrame, pd.DataFrame]]:
    """Agreement and swaps of each metric with each other preset that has rows and budgets of it.

    Agreement is Kendall's tau-b between the means of the methods that both have on every scene, at
    each budget: 1 is the same order, -1 the reverse, nan with fewer than two methods. A swap is a
    pair of methods that the presets put in opposite orders: `first` leads on `convention`, `second`
    on `other`. gap, low and high are the paired difference first - second with its interval on
    `convention`, other_gap and so on that on `other`. `is_resolved`: both intervals exclude zero.
    """
    for each in scores:
        own = ", ".join(sorted(set(each.rows["preset"])))
        for preset, table in others.items():
            other = Scores(table, each.metric)
            keys = ["method", "target_spp"]
            means = mean_over_scenes(each.scene_means).merge(
                mean_over_scenes(other.scene_means), on=keys, suffixes=("", "_other")
            )
            if other.measured.empty or means.empty:
                continue
            named = {"convention": own, "other": preset}
            taus, swaps = [], []
            for spp, part in means.groupby("target_spp"):
                both = part["value"], part["value_other"]
                tau = float(stats.kendalltau(*both).statistic) if len(part) > 1 else math.nan
                count = {"tau": tau, "rows": len(part)}
                taus.append({"target_spp": spp, **named, **count})
                swaps += [
                    {"target_spp": spp, **named, **swap} for swap in _swaps(part, each, other)
                ]
            kind = {"metric": each.metric, "method": f"{each.metric}, {preset}"}
            yield (
                pd.DataFrame(taus).assign(table="tau", **kind),
                pd.DataFrame(swaps).assign(table="swap", **kind),
            )


def _swaps(means: pd.DataFrame, scores: Scores, other: Scores) -> Iterator[dict[str, object]]:
    """The swaps at one budget, from the means of the methods on both presets."""
    sign = -1 if scores.direction == "lower" else 1
    rows = means.sort_values("method").to_dict("records")
    for a, b in combinations(rows, 2):
        lead = sign * (a["value"] - b["value"])
        if lead * sign * (a["value_other"] - b["value_other"]) >= 0:
            continue
        pair = (a["method"], b["method"]) if lead > 0 else (b["method"], a["method"])
        gaps = {"": scores.gap(*pair, a["target_spp"]), "other_": other.gap(*pair, a["target_spp"])}
        swap: dict[str, object] = dict(zip(("first", "second"), pair, strict=True))
        for prefix, gap in gaps.items():
            swap |= {f"{prefix}gap": gap.mean, f"{prefix}low": gap.low, f"{prefix}high": gap.high}
            swap[f"{prefix}excludes_zero"] = gap.excludes_zero
        yield swap | {"is_resolved": all(gap.excludes_zero for gap in gaps.values())}


def _agreement_table(taus: pd.DataFrame) -> Table:
    order = list(dict.fromkeys(taus["method"]))
    header, rows = pivot(taus, _format_tau, order, "metric, other preset")
    note = (
        "Kendall's tau-b between the order of rows on these clips and on those of another preset: "
        "1 is the same order, -1 the reverse. Brackets: the number of rows that both have at that "
        "budget."
    )
    return Table("Agreement of the order with other presets", "", header, rows, note)


def _format_tau(row: Record) -> str:
    return f"{row['tau']:.2f} ({row['rows']})" if row["rows"] > 1 else "-"


def _describe(swapped: pd.DataFrame) -> list[str]:
    """How many pairs swap places, and a sentence for each swap that is resolved on both presets."""
    if "is_resolved" not in swapped:
        return []
    resolved = swapped[swapped["is_resolved"]]
    total = (
        f"{len(swapped)} swaps, {len(resolved)} of them resolved: on both presets the "
        f"{INTERVAL_NOTE} of the paired difference excludes zero."
    )
    sentences = [
        f"{row.target_spp:g} spp: {row.first} leads {row.second} on {row.convention} by "
        f"{row.gap:+.3g} [{row.low:+.3g}, {row.high:+.3g}] and trails on {row.other} by "
        f"{row.other_gap:+.3g} [{row.other_low:+.3g}, {row.other_high:+.3g}]; resolved"
        for row in resolved.itertuples()
    ]
    return [f"{swapped['method'].iloc[0]}: {text}" for text in (total, *sentences)]

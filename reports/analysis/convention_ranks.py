"""Ranks of methods under several conventions, or on several presets, and pairs that swap places."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from itertools import combinations
from typing import Any

import pandas as pd
from scipy import stats

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.intervals import (
    BOOTSTRAP_SAMPLES,
    INTERVAL_NOTE,
    mean_with_interval,
    pair,
)

__all__ = [
    "OF_RUNS",
    "conventions_by_metric",
    "describe_swaps",
    "rank_agreement",
    "rank_by_convention",
    "swaps",
]

OF_RUNS = "srgb"  # the convention of metrics without @: that of runs


def conventions_by_metric(rows: pd.DataFrame) -> dict[str, dict[str, str]]:
    """The metrics with scores under two conventions or more: name to convention to row name.

    >>> rows = pd.DataFrame({"metric": ["psnr", "psnr@hable", "relmse"], "value": 1.0})
    >>> conventions_by_metric(rows)
    {'psnr': {'srgb': 'psnr', 'hable': 'psnr@hable'}}
    """
    found: dict[str, dict[str, str]] = {}
    for name in rows.loc[rows["value"].notna(), "metric"].unique():
        metric, _, convention = str(name).partition("@")
        found.setdefault(metric, {})[convention or OF_RUNS] = str(name)
    ordered = {
        metric: dict(sorted(names.items(), key=lambda item: (item[0] != OF_RUNS, item[0])))
        for metric, names in found.items()
    }
    return {metric: names for metric, names in sorted(ordered.items()) if len(names) > 1}


def rank_by_convention(scores: dict[str, Scores]) -> pd.DataFrame:
    """Columns target_spp, convention, method, mean and rank, 1 for the best; equal means share it.

    `scores` are those of one metric by convention, or by preset. Methods and budgets that lack a
    scene or a convention are left out, so that all columns rank the same methods.
    """
    means = pd.concat(
        [
            mean_over_scenes(each.scene_means).assign(convention=name)
            for name, each in scores.items()
        ]
    )
    groups = means.groupby(["method", "target_spp"])["convention"]
    means = means[groups.transform("nunique") == len(scores)].rename(columns={"value": "mean"})
    is_lower_better = next(iter(scores.values())).direction == "lower"
    ranks = means.groupby(["target_spp", "convention"])["mean"].rank(
        ascending=is_lower_better, method="min"
    )
    columns = ["target_spp", "convention", "method", "mean", "rank"]
    return means.assign(rank=ranks.astype(int))[columns].reset_index(drop=True)


def rank_agreement(ranked: pd.DataFrame) -> pd.DataFrame:
    """Columns target_spp, convention, other and tau: Kendall's tau-b between the means.

    1 is the same order, -1 the reverse. NaN with fewer than two methods.
    """
    records = []
    for spp, part in ranked.groupby("target_spp"):
        means = part.pivot_table("mean", "method", "convention")
        for convention, other in combinations(_in_order(part), 2):
            both = means[convention], means[other]
            tau = stats.kendalltau(*both).statistic if len(means) > 1 else math.nan
            names = {"convention": convention, "other": other}
            records.append({"target_spp": spp, **names, "tau": float(tau)})
    return pd.DataFrame(records, columns=["target_spp", "convention", "other", "tau"])


def swaps(
    scores: dict[str, Scores],
    ranked: pd.DataFrame,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """The pairs of methods that two conventions put in opposite orders, a row each.

    `first` leads under `convention`, `second` under `other`. gap, low and high are the paired
    difference first - second with its interval under `convention`, other_gap and so on under
    `other`; signs are those of the scores. `is_resolved`: both intervals exclude zero.
    """
    sign = -1 if next(iter(scores.values())).direction == "lower" else 1
    records = []
    for spp, part in ranked.groupby("target_spp"):
        means = sign * part.pivot_table("mean", "method", "convention")
        for convention, other in combinations(_in_order(part), 2):
            for a, b in combinations(means.index, 2):
                lead, other_lead = (means.loc[a, c] - means.loc[b, c] for c in (convention, other))
                if lead * other_lead >= 0:
                    continue
                pair_names = (str(a), str(b)) if lead > 0 else (str(b), str(a))
                record = {"target_spp": spp, "convention": convention, "other": other}
                record |= dict(zip(("first", "second"), pair_names, strict=True))
                for prefix, name in (("", convention), ("other_", other)):
                    gap = _gap(scores[name], pair_names, float(str(spp)), seed, draws)
                    record |= {f"{prefix}{key}": value for key, value in gap.items()}
                resolved = [record[f"{prefix}excludes_zero"] for prefix in ("", "other_")]
                records.append({**record, "is_resolved": all(resolved)})
    return pd.DataFrame(records)


def describe_swaps(
    swapped: pd.DataFrame, preposition: str = "under", noun: str = "conventions"
) -> list[str]:
    """A sentence for each of `swaps`, resolved ones first; one sentence where there is none."""
    if swapped.empty:
        return [f"No pair of methods swaps places between any two {noun}."]
    ordered = swapped.sort_values("is_resolved", ascending=False, kind="stable")
    resolved = int(swapped["is_resolved"].sum())
    total = f"{len(swapped)} swaps, {resolved} of them resolved: {preposition} both {noun} the "
    total += f"{INTERVAL_NOTE} of the paired difference excludes zero."
    return [total, *(_describe_swap(row, preposition) for row in ordered.to_dict("records"))]


def _describe_swap(row: Mapping[Hashable, Any], preposition: str) -> str:
    def lead(prefix: str) -> str:
        gap, low, high = (row[f"{prefix}{name}"] for name in ("gap", "low", "high"))
        return f"{gap:+.3g} [{low:+.3g}, {high:+.3g}]"

    return (
        f"{row['target_spp']:g} spp: {row['first']} leads {row['second']} {preposition} "
        f"{row['convention']} by {lead('')} and trails {preposition} {row['other']} by "
        f"{lead('other_')}; {'resolved' if row['is_resolved'] else 'not resolved'}"
    )


def _gap(
    scores: Scores, methods: tuple[str, str], spp: float, seed: int, draws: int
) -> dict[str, float | bool]:
    frames = scores.per_frame[scores.per_frame["target_spp"] == spp]
    first, second = (frames[frames["method"] == method] for method in methods)
    gap = mean_with_interval(pair(first, second), seed, draws)
    excludes_zero = gap.low > 0 or gap.high < 0
    return {"gap": gap.mean, "low": gap.low, "high": gap.high, "excludes_zero": excludes_zero}


def _in_order(part: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(part["convention"]))

"""Two methods against each other, budget by budget, paired by frame, with scenes as units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.aggregate import Scores
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, FRAME, Interval, mean_with_interval
from reports.analysis.multiplicity import holm
from reports.analysis.power import smallest_resolvable
from reports.analysis.robust import (
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
)
from reports.analysis.verdicts import TIE_DB, name_verdict

__all__ = ["BudgetComparison", "Comparison", "compare_at_budgets"]

KEYS = [*FRAME, "seed"]  # what the two scores of a pair have in common


@dataclass(frozen=True)
class BudgetComparison:
    """Two methods at one budget. Differences are first minus second."""

    target_spp: float
    first: float  # mean score over scenes
    second: float
    difference: Interval
    verdict: str  # on the first: leads, trails, tie, not resolved; empty: no interval
    p_holm: float  # corrected for all budgets of the comparison
    resolvable: float  # smallest difference that is resolved with power 80 %
    interquartile_mean: float  # of the differences of scenes
    improvement: float  # chance that the first is better on a random scene
    ahead: float  # share of scenes where the first is better by more than a tie
    behind: float  # share of scenes where it is worse by more than a tie
    pairs: int  # of frames
    unpaired: int  # scores that only one of the two has


@dataclass(frozen=True)
class Comparison:
    """Two methods on the same clips and device, at every budget that both have."""

    first: str
    second: str
    metric: str
    unit: str
    convention: str
    direction: str
    device: str
    scenes: tuple[str, ...]
    clips: int
    seeds: tuple[int, ...]  # of the order of samples
    budgets: tuple[BudgetComparison, ...]
    notes: tuple[str, ...]


def compare_at_budgets(
    scores: Scores, first: str, second: str, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES
) -> tuple[BudgetComparison, ...]:
    """The comparison at each budget at which both methods have a score of the same frame."""
    parts = {key: part for key, part in scores.measured.groupby(["method", "target_spp"])}
    results = []
    for spp in sorted(set(scores.measured["target_spp"])):
        if (first, spp) in parts and (second, spp) in parts:
            sides = parts[first, spp], parts[second, spp]
            pairs = sides[0].merge(sides[1], on=KEYS, validate="one_to_one")
            if len(pairs):
                results.append(_compare(scores, spp, pairs, sides, (seed, draws)))
    p_holm = holm([each.difference.p_value for each in results])
    return tuple(replace(b, p_holm=float(p)) for b, p in zip(results, p_holm, strict=True))


def _compare(
    scores: Scores,
    spp: float,
    pairs: pd.DataFrame,
    sides: Sequence[pd.DataFrame],
    bootstrap: tuple[int, int],
) -> BudgetComparison:
    unit = scores.column_text("unit")
    gap = mean_with_interval(pairs.assign(value=pairs["value_x"] - pairs["value_y"]), *bootstrap)
    first, second = (_by_run(pairs, column) for column in ("value_x", "value_y"))
    sign = -1 if scores.direction == "lower" else 1
    margin = TIE_DB if unit == "dB" else 0.0
    return BudgetComparison(
        target_spp=spp,
        first=float(_scene_means(pairs, "value_x").mean()),
        second=float(_scene_means(pairs, "value_y").mean()),
        difference=gap,
        verdict=name_verdict(gap, unit, scores.direction),
        p_holm=np.nan,
        resolvable=smallest_resolvable(gap.deviation, gap.units),
        interquartile_mean=interquartile_mean(first - second),
        improvement=probability_of_improvement(sign * first, sign * second),
        ahead=performance_profile(sign * (first - second), [margin])[0],
        behind=performance_profile(sign * (second - first), [margin])[0],
        pairs=len(pairs),
        unpaired=sum(map(len, sides)) - 2 * len(pairs),
    )


def _scene_means(pairs: pd.DataFrame, column: str) -> pd.Series[float]:
    clips = pairs.groupby(["scene", "clip"])[column].mean()
    means: pd.Series[float] = clips.groupby("scene").mean()
    return means


def _by_run(pairs: pd.DataFrame, column: str) -> NDArray[np.float64]:
    """Scores [runs scenes]; a run is an order of samples that every scene has, else their mean."""
    clips = pairs.groupby(["seed", "scene", "clip"])[column].mean()
    table = clips.groupby(["seed", "scene"]).mean().unstack("scene")
    if table.isna().any(axis=None):
        table = _scene_means(pairs, column).to_frame().T
    return table.to_numpy(float)

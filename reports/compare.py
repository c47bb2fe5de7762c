"""Two methods compared, paired by frame, with scenes as units: the answer as data and text.

Robust aggregates of scores [runs scenes] are those of Agarwal et al. 2021 (Deep Reinforcement
Learning at the Edge of the Statistical Precipice, section 4) and of their library rliable; a scene
takes the place of a task, an order of samples that of a run. `rlbench compare` prints the answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from reports.analysis.differences import (
    TIE_DB,
    VERDICT_NOTE,
    describe_difference,
    holm,
    holm_mark,
    name_verdict,
)
from reports.analysis.intervals import (
    FRAME,
    POWER,
    Interval,
    mean_with_interval,
    smallest_resolvable,
)
from reports.analysis.rows import ReportError, check_comparable, remarks, select_device
from reports.analysis.scores import Scores
from reports.decide import check_ranks
from reports.layout.tables import score_name

KEYS = [*FRAME, "seed", "target_spp"]  # what the two scores of a pair have in common
MIN_SCENES = 4  # of a probability, and of a mean of the middle half
Runs = NDArray[np.float64]  # [runs scenes]


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


def compare(
    results: pd.DataFrame, first: str, second: str, metric: str = "psnr", device: str = ""
) -> Comparison:
    """Compare two methods of the results at every budget that both have.

    Scores are paired by scene, clip, frame and seed of the sample order. They need no device:
    `device` names one where a method has scores of several. Raises ReportError if a method, a
    metric or a pair is missing, or if rows cannot be compared.
    """
    results = results[results["method"].isin([first, second]) & (results["unit"] != "ms")]
    if results["method"].nunique() < 2:
        found = ", ".join(sorted(set(results["method"]))) or "neither"
        raise ReportError(
            f"a comparison of {first} and {second} was requested, and the results have {found}; "
            "name two different rows, or measure them with rlbench run"
        )
    if not device and (results.groupby("method")["device"].nunique() == 1).all():
        results = results.assign(device="; ".join(sorted(set(results["device"]))))
    rows, device = select_device(results, device)
    check_comparable(rows)
    scores = Scores(rows, metric, device)
    check_ranks(scores)
    sides = [scores.measured[scores.measured["method"] == method] for method in (first, second)]
    both = sides[0].merge(sides[1], on=KEYS, validate="one_to_one")
    if both.empty:
        raise ReportError(
            f"{first} and {second} have no score of {metric} on the same frame at the same budget; "
            f"measure both: rlbench run -m {first},{second}"
        )
    budgets = [
        _compare(scores, float(str(spp)), pairs, sum((s["target_spp"] == spp).sum() for s in sides))
        for spp, pairs in both.groupby("target_spp")
    ]
    p_holm = holm([each.difference.p_value for each in budgets])
    return Comparison(
        first=first,
        second=second,
        metric=metric,
        unit=scores.column_text("unit"),
        convention=scores.convention,
        direction=scores.direction,
        device=device,
        scenes=tuple(sorted(set(both["scene"]))),
        clips=both["clip"].nunique(),
        seeds=tuple(sorted(set(both["seed"]))),
        budgets=tuple(replace(b, p_holm=float(p)) for b, p in zip(budgets, p_holm, strict=True)),
        notes=tuple(remarks(scores.measured)),
    )


def _compare(scores: Scores, spp: float, pairs: pd.DataFrame, count: int) -> BudgetComparison:
    """The comparison at one budget; `count` scores of both methods are in pairs or alone."""
    unit = scores.column_text("unit")
    gap = mean_with_interval(pairs.assign(value=pairs["value_x"] - pairs["value_y"]))
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
        unpaired=int(count) - 2 * len(pairs),
    )


def _scene_means(pairs: pd.DataFrame, column: str) -> pd.Series[float]:
    clips = pairs.groupby(["scene", "clip"])[column].mean()
    means: pd.Series[float] = clips.groupby("scene").mean()
    return means


def _by_run(pairs: pd.DataFrame, column: str) -> Runs:
    """Scores [runs scenes]; a run is an order of samples that every scene has, else their mean."""
    clips = pairs.groupby(["seed", "scene", "clip"])[column].mean()
    table = clips.groupby(["seed", "scene"]).mean().unstack("scene")
    if table.isna().any(axis=None):
        table = _scene_means(pairs, column).to_frame().T
    return table.to_numpy(float)


def interquartile_mean(scores: Runs) -> float:
    """Mean of the middle half of all runs and scenes: one bad scene moves it little.

    >>> interquartile_mean(np.array([[-40.0, 1.0, 2.0, 9.0]]))
    1.5
    """
    return float(stats.trim_mean(scores, proportiontocut=0.25, axis=None))


def probability_of_improvement(first: Runs, second: Runs) -> float:
    """Chance that a run of `first` scores higher than one of `second` on the same random scene.

    Equal scores count half. Both have the same scenes; their runs may differ in number.

    >>> probability_of_improvement(np.array([[2.0, 2.0, 1.0]]), np.array([[1.0, 3.0, 1.0]]))
    0.5
    """
    signs = np.sign(first[:, None] - second[None])  # runs runs scenes
    return float((signs + 1).mean() / 2)


def performance_profile(scores: Runs, thresholds: Sequence[float]) -> list[float]:
    """Share of runs and scenes whose score is above each threshold.

    >>> performance_profile(np.array([[0.0, 0.2, 0.4, 0.6]]), [0.0, 0.5])
    [0.75, 0.25]
    """
    return [float((scores > threshold).mean()) for threshold in thresholds]


def comparison_text(comparison: Comparison) -> str:
    """Lines for people: a sentence for each budget, then how to read it."""
    metric = score_name(comparison.metric)
    head = (
        f"{comparison.first} against {comparison.second}: {metric} ({comparison.convention}; "
        f"{comparison.direction} is better), {_count(len(comparison.scenes), 'scene')}, "
        f"{_count(comparison.clips, 'clip')}, {_count(len(comparison.seeds), 'order')} of samples, "
        f"on {comparison.device or 'an unnamed device'}."
    )
    budgets = [line for each in comparison.budgets for line in _budget_lines(each, comparison)]
    return "\n".join([head, "", *budgets, "", *_reading(comparison)])


def _budget_lines(budget: BudgetComparison, comparison: Comparison) -> Iterator[str]:
    unit = comparison.unit
    digits = ".2f" if unit == "dB" else ".3g"
    sentence = describe_difference(budget.difference, unit, comparison.direction)
    mark = holm_mark(budget.verdict, budget.p_holm)
    yield (
        f"{budget.target_spp:g} spp: {comparison.first} {sentence}{mark} "
        f"({budget.first:{digits}} against {budget.second:{digits}})"
    )
    margin = f" by more than {TIE_DB:g} dB" if unit == "dB" else ""
    details = [f"ahead{margin} on {budget.ahead:.0%} of scenes, behind on {budget.behind:.0%}"]
    if len(comparison.scenes) >= MIN_SCENES:
        details += [
            f"better on a random scene with probability {budget.improvement:.2f}",
            f"interquartile mean {budget.interquartile_mean:+{digits}}",
        ]
    if budget.resolvable == budget.resolvable:
        details.append(f"resolvable from {budget.resolvable:{digits}} {unit}".rstrip())
    if budget.unpaired:
        details.append(f"{budget.unpaired} scores without a partner left out")
    yield f"    {'; '.join(details)}"


def _reading(comparison: Comparison) -> Iterator[str]:
    yield (
        f"Differences are {comparison.first} minus {comparison.second}, paired by frame, averaged "
        f"over the frames of a clip, the clips of a scene, and scenes. {VERDICT_NOTE}"
    )
    yield (
        f"These are {_count(len(comparison.budgets), 'difference')}. Resolvable: the "
        f"smallest difference that these clips resolve with power {100 * POWER:.0f} %."
    )
    yield from comparison.notes


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"

"""A comparison of two methods as text: a sentence for each budget, then how to read it."""

from __future__ import annotations

from collections.abc import Iterator

from reports.analysis.comparison import BudgetComparison, Comparison
from reports.analysis.intervals import LEVEL
from reports.analysis.power import POWER
from reports.analysis.verdicts import (
    HOLM_MARK,
    LEADS,
    TIE_DB,
    TRAILS,
    VERDICT_NOTE,
    describe_difference,
)

__all__ = ["comparison_text"]


def comparison_text(comparison: Comparison) -> str:
    """Lines for people."""
    scenes, clips, seeds = len(comparison.scenes), comparison.clips, len(comparison.seeds)
    metric = "PSNR" if comparison.metric == "psnr" else comparison.metric
    head = (
        f"{comparison.first} against {comparison.second}: {metric} ({comparison.convention}; "
        f"{comparison.direction} is better), {_count(scenes, 'scene')}, {_count(clips, 'clip')}, "
        f"{_count(seeds, 'order')} of samples, on {comparison.device or 'an unnamed device'}."
    )
    budgets = [line for each in comparison.budgets for line in _budget_lines(each, comparison)]
    return "\n".join([head, "", *budgets, "", *_reading(comparison)])


def _budget_lines(budget: BudgetComparison, comparison: Comparison) -> Iterator[str]:
    unit = comparison.unit
    digits = ".2f" if unit == "dB" else ".3g"
    sentence = describe_difference(budget.difference, unit, comparison.direction)
    is_lead = budget.verdict in (LEADS, TRAILS)
    mark = HOLM_MARK * (is_lead and budget.p_holm > 1 - LEVEL)
    yield (
        f"{budget.target_spp:g} spp: {comparison.first} {sentence}{mark} "
        f"({budget.first:{digits}} against {budget.second:{digits}})"
    )
    margin = f" by more than {TIE_DB:g} dB" if unit == "dB" else ""
    details = [
        f"ahead{margin} on {budget.ahead:.0%} of scenes, behind on {budget.behind:.0%}",
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
        f"The correction is for {_count(len(comparison.budgets), 'budget')}. Resolvable: the "
        f"smallest difference that these clips resolve with power {100 * POWER:.0f} %."
    )
    yield from comparison.notes


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"

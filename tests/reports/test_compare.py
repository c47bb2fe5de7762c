"""Two methods compared: equal to scipy on their paired scenes, and what the text says."""

from __future__ import annotations

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy import stats

from reports.analysis.rows import ReportError
from reports.compare import (
    compare,
    comparison_text,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
)
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import SCENES, rows

OFFSETS = dict(zip(sorted(SCENES), (0.5, 0.9, 1.0, 1.4), strict=True))  # dB, theirs minus ours


def shifted(offsets, method="theirs", seed=0):
    """PSNR of `ours`, and of a method that differs by an offset in each scene."""
    ours = [replace(r, seed=seed) for r in rows(["ours"], metric="psnr")]
    theirs = [replace(r, method=method, value=r.value + offsets[r.scene]) for r in ours]
    return ours + theirs


@pytest.fixture(scope="module")
def comparison():
    return compare(to_dataframe(shifted(OFFSETS)), "theirs", "ours")


def test_the_interval_and_p_are_those_of_scipys_test_of_related_scenes(comparison):
    test = stats.ttest_1samp(list(OFFSETS.values()), 0.0)
    ends = test.confidence_interval(0.95)
    budget = comparison.budgets[1]
    difference = budget.difference
    assert (difference.low, difference.high) == pytest.approx((ends.low, ends.high))
    assert difference.p_value == pytest.approx(test.pvalue)
    assert budget.p_holm == pytest.approx(len(comparison.budgets) * test.pvalue)


def test_the_other_order_has_the_opposite_verdict(comparison):
    other = compare(to_dataframe(shifted(OFFSETS)), "ours", "theirs")
    for one, two in zip(comparison.budgets, other.budgets, strict=True):
        assert (one.verdict, two.verdict) == ("leads", "trails")
        assert one.difference.low == pytest.approx(-two.difference.high)
        assert one.improvement + two.improvement == 1
        assert (one.ahead, one.behind) == (two.behind, two.ahead)


def test_robust_aggregates_are_over_scenes(comparison):
    budget = comparison.budgets[0]
    assert budget.interquartile_mean == pytest.approx((0.9 + 1.0) / 2)
    assert (budget.improvement, budget.ahead, budget.behind) == (1.0, 1.0, 0.0)


def test_several_orders_of_samples_are_runs_of_the_same_scenes():
    worse = {scene: -offset for scene, offset in OFFSETS.items()}
    table = to_dataframe([*shifted(OFFSETS, seed=0), *shifted(worse, seed=1)])
    budget = compare(table, "theirs", "ours").budgets[0]
    assert budget.difference.mean == pytest.approx(0.0)
    assert budget.difference.units == len(SCENES)
    assert budget.improvement == pytest.approx(0.5)


def test_scores_without_a_partner_are_left_out_and_counted():
    table = [r for r in shifted(OFFSETS) if (r.method, r.clip) != ("ours", "hall-0")]
    comparison = compare(to_dataframe(table), "theirs", "ours")
    assert comparison.budgets[0].unpaired == 4
    assert comparison.clips == 2 * len(SCENES) - 1
    assert "4 scores without a partner left out" in comparison_text(comparison)


def test_an_error_that_is_lower_leads(results):
    budget = compare(results, "ours", "mean", metric="relmse").budgets[0]
    assert budget.difference.mean < 0
    assert budget.improvement == 1.0


def test_the_answer_is_text_and_json(comparison):
    text = comparison_text(comparison)
    assert text.count("spp: theirs leads by 0.95 dB [0.36, 1.54]") == len(comparison.budgets)
    assert "4 scenes, 8 clips, 1 order of samples, on NVIDIA RTX 2080 Ti" in text
    deviation = np.std(list(OFFSETS.values()), ddof=1)
    assert f"resolvable from {2.128 * deviation:.2f} dB" in text
    assert json.loads(msgspec.json.encode(comparison))["budgets"][0]["verdict"] == "leads"


def test_a_probability_needs_four_scenes(comparison):
    assert "with probability" in comparison_text(comparison)
    results = to_dataframe(shifted(OFFSETS))
    few = results[results["scene"].isin(sorted(OFFSETS)[:3])]
    assert "probability" not in comparison_text(compare(few, "theirs", "ours"))


@pytest.mark.parametrize("second", ["ours", "thiers"])
def test_a_comparison_needs_two_rows(second):
    with pytest.raises(ReportError, match="have ours; name two different rows"):
        compare(to_dataframe(shifted(OFFSETS)), "ours", second)


def runs_of(seed, runs=5, scenes=4):
    return np.random.default_rng(seed).integers(0, 8, (runs, scenes)).astype(float)  # with ties


@pytest.mark.parametrize("seed", range(2))
def test_robust_aggregates_are_those_of_slow_twins(seed):
    """The middle half of all scores, the mean of Mann-Whitney statistics, a count."""
    first, second = runs_of(seed), runs_of(seed + 100, runs=3)
    flat, thresholds = sorted(first.ravel().tolist()), [-1.0, 2.0, 2.5, 7.0]
    assert interquartile_mean(first) == pytest.approx(sum(flat[5:15]) / 10)
    chances = [
        stats.mannwhitneyu(a, b).statistic / (len(a) * len(b))
        for a, b in zip(first.T, second.T, strict=True)
    ]
    assert probability_of_improvement(first, second) == pytest.approx(np.mean(chances))
    expected = [sum(value > each for value in flat) / len(flat) for each in thresholds]
    assert performance_profile(first, thresholds) == pytest.approx(expected)

"""Robust aggregates: slow twins of the definitions of rliable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from reports.compare import (
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
)


def scores(seed, runs=5, scenes=4):
    return np.random.default_rng(seed).integers(0, 8, (runs, scenes)).astype(float)  # with ties


@pytest.mark.parametrize("seed", range(5))
def test_the_interquartile_mean_leaves_out_a_quarter_of_the_scores_at_each_end(seed):
    flat = sorted(scores(seed).ravel())
    assert interquartile_mean(scores(seed)) == pytest.approx(sum(flat[5:15]) / 10)


@pytest.mark.parametrize("seed", range(5))
def test_the_probability_of_improvement_is_the_mean_of_mann_whitney_statistics(seed):
    first, second = scores(seed), scores(seed + 100, runs=3)
    chances = [
        stats.mannwhitneyu(a, b).statistic / (len(a) * len(b))
        for a, b in zip(first.T, second.T, strict=True)
    ]
    assert probability_of_improvement(first, second) == pytest.approx(np.mean(chances))


@pytest.mark.parametrize("seed", range(5))
def test_a_profile_counts_the_scores_above_each_threshold(seed):
    flat, thresholds = scores(seed).ravel().tolist(), [-1.0, 2.0, 2.5, 7.0]
    expected = [sum(value > each for value in flat) / len(flat) for each in thresholds]
    assert performance_profile(scores(seed), thresholds) == pytest.approx(expected)

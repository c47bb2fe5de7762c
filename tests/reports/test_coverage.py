"""Intervals over scenes contain the truth as often as they say: simulated."""

from __future__ import annotations

import numpy as np
import pytest

from reports.analysis.intervals import interval_ends

TRIALS = 4000
DISTRIBUTIONS = {  # draws of units with mean 0 and deviation 1; skewness
    "normal (0)": lambda g, shape: g.normal(0, 1, shape),
    "gamma (0.7)": lambda g, shape: (g.gamma(8, 1, shape) - 8) / np.sqrt(8),
    "gamma (1)": lambda g, shape: (g.gamma(4, 1, shape) - 4) / 2,
}


def coverage(name, units, trials=TRIALS, draws=1000):
    values = DISTRIBUTIONS[name](np.random.default_rng(units), (units, trials))
    low, high = interval_ends(values, draws=draws)
    return float(((low <= 0) & (high >= 0)).mean())


@pytest.mark.slow
@pytest.mark.parametrize("units", [4, 12, 16, 24, 48])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_a_95_percent_interval_covers_the_truth_in_93_to_97_percent(name, units, record_property):
    share = coverage(name, units)
    record_property(f"coverage, {name}, {units} units", share)
    # 4000 trials scatter by 0.3 %, so the bounds leave 1.5 standard errors for the estimate
    assert 0.925 <= share <= 0.975


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_eight_units_cover_92_percent_or_more(name, record_property):
    share = coverage(name, 8)
    record_property(f"coverage, {name}, 8 units", share)
    assert share >= 0.915

"""The smallest difference that can be resolved: tables of power, and simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reports.analysis.intervals import interval_ends
from reports.analysis.intervals import smallest_resolvable, standardised_resolvable


@pytest.mark.parametrize(("effect", "units"), [(0.2, 199), (0.5, 34), (0.8, 15)])
def test_units_for_the_effects_of_cohen_are_those_of_published_tables(effect, units):
    """Sizes of a paired t-test at 5 % and power 80 % (G*Power 3.1, Faul et al. 2007)."""
    assert standardised_resolvable(units) <= effect < standardised_resolvable(units - 1)


@pytest.mark.parametrize("units", [3, 4, 6])
def test_such_a_difference_is_resolved_in_four_of_five_trials(units):
    generator = np.random.default_rng(units)
    size = smallest_resolvable(0.3, units)
    low, _ = interval_ends(generator.normal(size, 0.3, (units, 2000)))
    share = np.mean(low > 0)
    assert share == pytest.approx(0.8, abs=0.036)  # 4 standard errors of a binomial


def test_one_scene_resolves_nothing_that_could_be_stated():
    assert math.isnan(smallest_resolvable(0.3, 1))


def test_twice_the_deviation_needs_twice_the_difference():
    assert smallest_resolvable(0.6, 8) == pytest.approx(2 * smallest_resolvable(0.3, 8))

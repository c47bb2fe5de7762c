"""Rank correlation and deviation: against scipy, brute force and closed forms."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy import stats

from reports.analysis.correlation import kendall_tau, std_with_interval

TIED = ([3.0, 1.0, 2.0, 2.0, 5.0], [30.0, 11.0, 10.0, 25.0, 24.0])


@pytest.mark.parametrize("seed", range(4))
def test_tau_and_its_p_are_those_of_scipy_without_ties(seed):
    one, other = np.random.default_rng(seed).standard_normal((2, 7))
    found, wanted = kendall_tau(one, other), stats.kendalltau(one, other, method="exact")
    assert (found.tau, found.chance) == pytest.approx((wanted.statistic, wanted.pvalue))


def test_tau_of_ties_is_tau_b():
    assert kendall_tau(*TIED).tau == pytest.approx(stats.kendalltau(*TIED).statistic)


def test_p_of_ties_is_the_share_of_all_orders():
    taus = [stats.kendalltau(TIED[0], order).statistic for order in permutations(TIED[1])]
    as_far = [abs(tau) >= stats.kendalltau(*TIED).statistic - 1e-9 for tau in taus]
    assert kendall_tau(*TIED).chance == pytest.approx(np.mean(as_far))


def test_random_orders_give_the_p_of_all_orders():
    one, other = np.arange(9.0), [1.0, 0, 3, 2, 6, 5, 4, 8, 7]
    exact = stats.kendalltau(one, other, method="exact").pvalue
    spread = math.sqrt(exact / 4000)  # binomial: standard error of a share of 4000 draws
    assert kendall_tau(one, other, draws=4000).chance == pytest.approx(
        exact, abs=4 * spread + 1 / 4e3
    )


def test_equal_orders_agree_wholly_and_one_in_n_factorial_by_chance_on_either_side():
    found = kendall_tau([1, 2, 3, 4], [10, 20, 30, 40])
    assert (found.tau, found.chance, found.rows) == (1, 2 / 24, 4)


@pytest.mark.parametrize("scores", [[], [1.0], [2.0, 2.0]])
def test_what_has_no_order_has_no_tau(scores):
    found = kendall_tau(scores, scores)
    assert math.isnan(found.tau)
    assert math.isnan(found.chance)


def test_the_deviation_of_one_to_three_is_one():
    found = std_with_interval([1.0, 2.0, 3.0])
    assert (found.value, found.count) == (1, 3)


def test_the_interval_of_a_deviation_is_that_of_chi_square():
    found = std_with_interval([1.0, 2.0, 3.0, 4.0, 5.0])
    ends = [math.sqrt(4 * 2.5 / stats.chi2(4).ppf(q)) for q in (0.975, 0.025)]
    assert (found.low, found.high) == pytest.approx(ends)


def test_the_interval_holds_the_true_deviation_as_often_as_it_says():
    drawn = np.random.default_rng(1).normal(0, 0.06, (2000, 5))
    held = [(d := std_with_interval(five)).low <= 0.06 <= d.high for five in drawn]
    assert np.mean(held) == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 2000))  # 4 errors


@pytest.mark.parametrize("numbers", [[], [21.0]])
def test_one_number_has_no_deviation(numbers):
    assert math.isnan(std_with_interval(numbers).value)

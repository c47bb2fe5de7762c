"""Rank correlation and deviation against scipy, brute force and closed forms."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy import stats

from reports.analysis.ranking import kendall_tau, std_with_interval

TIED = ([3.0, 1.0, 2.0, 2.0, 5.0], [30.0, 11.0, 10.0, 25.0, 24.0])


@pytest.mark.parametrize("seed", range(4))
def test_without_ties_tau_and_p_are_those_of_scipys_exact_test(seed):
    one, other = np.random.default_rng(seed).standard_normal((2, 7))
    ours, scipys = kendall_tau(one, other), stats.kendalltau(one, other, method="exact")
    assert (ours.tau, ours.p_value) == pytest.approx((scipys.statistic, scipys.pvalue))


def test_tau_with_ties_is_tau_b():
    assert kendall_tau(*TIED).tau == pytest.approx(stats.kendalltau(*TIED).statistic)


def test_p_with_ties_is_the_share_of_all_orders():
    taus = [stats.kendalltau(TIED[0], order).statistic for order in permutations(TIED[1])]
    is_as_far = [abs(tau) >= stats.kendalltau(*TIED).statistic - 1e-9 for tau in taus]
    assert kendall_tau(*TIED).p_value == pytest.approx(np.mean(is_as_far))


def test_random_orders_estimate_the_p_of_all_orders():
    one, other = np.arange(9.0), [1.0, 0, 3, 2, 6, 5, 4, 8, 7]
    exact = stats.kendalltau(one, other, method="exact").pvalue
    error = math.sqrt(exact / 4000)  # binomial: standard error of a share of 4000 draws
    assert kendall_tau(one, other, draws=4000).p_value == pytest.approx(
        exact, abs=4 * error + 1 / 4e3
    )


def test_equal_orders_have_tau_1_and_p_2_in_n_factorial():
    result = kendall_tau([1, 2, 3, 4], [10, 20, 30, 40])
    assert (result.tau, result.p_value, result.rows) == (1, 2 / 24, 4)


@pytest.mark.parametrize("scores", [[], [1.0], [2.0, 2.0]])
def test_scores_without_an_order_have_no_tau(scores):
    result = kendall_tau(scores, scores)
    assert math.isnan(result.tau)
    assert math.isnan(result.p_value)


def test_the_deviation_of_one_to_three_is_one():
    result = std_with_interval([1.0, 2.0, 3.0])
    assert (result.value, result.count) == (1, 3)


def test_the_interval_of_a_deviation_is_the_chi_square_interval():
    result = std_with_interval([1.0, 2.0, 3.0, 4.0, 5.0])
    ends = [math.sqrt(4 * 2.5 / stats.chi2(4).ppf(q)) for q in (0.975, 0.025)]
    assert (result.low, result.high) == pytest.approx(ends)


def test_the_interval_covers_the_true_deviation_at_its_level():
    drawn = np.random.default_rng(1).normal(0, 0.06, (2000, 5))
    is_covered = [(d := std_with_interval(five)).low <= 0.06 <= d.high for five in drawn]
    assert np.mean(is_covered) == pytest.approx(
        0.95, abs=4 * math.sqrt(0.95 * 0.05 / 2000)
    )  # 4 errors


@pytest.mark.parametrize("numbers", [[], [21.0]])
def test_one_number_has_no_deviation(numbers):
    assert math.isnan(std_with_interval(numbers).value)

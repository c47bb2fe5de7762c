"""Rank correlation between two sets of scores, and the standard deviation between trainings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from reports.analysis.intervals import LEVEL

__all__ = [
    "MAX_PERMUTATIONS",
    "Deviation",
    "RankCorrelation",
    "kendall_tau",
    "std_with_interval",
]

MAX_PERMUTATIONS = 10_000  # all orders are counted if there are at most so many, else drawn
_BATCH = 1_000  # orders that are in memory at once


@dataclass(frozen=True)
class RankCorrelation:
    """Kendall's tau-b of two sets of scores and its p-value."""

    tau: float  # in [-1, 1]; nan with fewer than two rows, or where all scores of a set are equal
    p_value: float  # two-sided, of the permutation test, in (0, 1]
    rows: int


@dataclass(frozen=True)
class Deviation:
    """Standard deviation of a sample and its confidence interval."""

    value: float  # with n - 1 in the denominator; nan with one number
    low: float
    high: float
    count: int


def kendall_tau(
    first: Sequence[float], second: Sequence[float], seed: int = 0, draws: int = MAX_PERMUTATIONS
) -> RankCorrelation:
    """Kendall's tau-b (Kendall 1945, The Treatment of Ties) of two scores of the same rows.

    The p-value is the share of orders of `second` whose tau is at least as far from zero: of all
    orders if there are at most `draws`, else of `draws` random orders and the given one, so that it
    is never zero (Phipson and Smyth 2010, Permutation P-values Should Never Be Zero).
    """
    count = len(first)
    tau = float(stats.kendalltau(first, second).statistic) if count > 1 else math.nan
    if math.isnan(tau):
        return RankCorrelation(math.nan, math.nan, count)
    signs = _difference_signs(np.asarray(first, float))

    def concordance(orders: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        """Distance of tau from zero, up to a factor that no order changes: a whole number."""
        pairs = _difference_signs(np.moveaxis(orders, axis, -1))
        distances: NDArray[np.float64] = np.abs(np.einsum("ij,...ij", signs, pairs))
        return distances

    # scipy's own two-sided p doubles one tail, which is another number where there are ties
    test = stats.permutation_test(
        (np.asarray(second, float),),
        concordance,
        permutation_type="pairings",
        alternative="greater",
        vectorized=True,
        n_resamples=draws,
        batch=_BATCH,
        rng=np.random.default_rng(seed),
    )
    return RankCorrelation(tau, float(test.pvalue), count)


def std_with_interval(values: Sequence[float], level: float = LEVEL) -> Deviation:
    """Standard deviation and its chi-square interval, which assumes normally distributed values."""
    count = len(values)
    if count < 2:
        return Deviation(math.nan, math.nan, math.nan, count)
    deviation, freedom = float(np.std(values, ddof=1)), count - 1
    low, high = (
        deviation * math.sqrt(freedom / float(stats.chi2.isf(tail, freedom)))
        for tail in ((1 - level) / 2, (1 + level) / 2)
    )
    return Deviation(deviation, low, high, count)


def _difference_signs(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signs of the differences of all pairs, [... n n] of values [... n]."""
    signs: NDArray[np.float64] = np.sign(values[..., :, None] - values[..., None, :])
    return signs

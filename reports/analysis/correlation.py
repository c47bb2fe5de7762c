"""How alike two orders are, and how far trainings lie apart: rank correlation and deviation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from reports.analysis.intervals import DRAWS, LEVEL


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b of two orders, in [-1, 1], and how often chance gives as much."""

    tau: float  # nan with fewer than two rows, or where one order is all ties
    chance: float  # two-sided p of the permutation test, in (0, 1]
    rows: int


@dataclass(frozen=True)
class Deviation:
    """Standard deviation of a few numbers, and where that of all may lie."""

    value: float  # of n - 1; nan with one number
    low: float
    high: float
    count: int


def kendall_tau(
    one: Sequence[float], other: Sequence[float], seed: int = 0, draws: int = DRAWS
) -> Agreement:
    """Do two scores order the same rows alike? Kendall 1945, The Treatment of Ties (tau-b).

    The p-value is the share of orders of `other` whose tau is as far from zero: of all of them
    where they are at most `draws`, else of as many random ones, which with the one found are never
    none (Phipson and Smyth 2010, Permutation P-values Should Never Be Zero).
    """
    count = len(one)
    left, right = _signs(one), _signs(other)
    scale = math.sqrt(float(np.abs(left).sum()) * float(np.abs(right).sum()))
    if not scale:
        return Agreement(math.nan, math.nan, count)
    found = float((left * right).sum()) / scale
    whole = math.factorial(min(count, 20)) <= draws
    random = np.random.default_rng(seed)
    orders = (
        map(np.array, permutations(range(count)))
        if whole
        else (random.permutation(count) for _ in range(draws))
    )
    taken = [abs(float((left * right[np.ix_(order, order)]).sum())) / scale for order in orders]
    as_far = sum(tau >= abs(found) - 1e-9 for tau in taken)  # equal sums of signs are equal taus
    chance = as_far / len(taken) if whole else (as_far + 1) / (draws + 1)
    return Agreement(found, chance, count)


def std_with_interval(values: Sequence[float], level: float = LEVEL) -> Deviation:
    """Standard deviation and its chi-square interval, which takes the numbers to be normal."""
    count = len(values)
    if count < 2:
        return Deviation(math.nan, math.nan, math.nan, count)
    found, free = float(np.std(values, ddof=1)), count - 1
    low, high = (
        found * math.sqrt(free / float(chdtri(free, tail)))
        for tail in ((1 - level) / 2, (1 + level) / 2)
    )
    return Deviation(found, low, high, count)


def _signs(values: Sequence[float]) -> NDArray[np.float64]:
    """Sign of each difference of two numbers."""
    numbers = np.asarray(values, float)
    signs: NDArray[np.float64] = np.sign(numbers[:, None] - numbers[None, :])
    return signs

"""Parts of variance: how far scores differ by scene, by training and by order of samples.

Every score is a mean plus random effects of the factors it was measured at, and of their
combinations: a crossed design with random effects and one score in each cell. Its mean squares are
solved for the variances by the method of moments (Searle, Casella and McCulloch 1992, Variance
Components, chapter 4). The estimates are unbiased, so one near zero may be negative. Sums keep the
sign; a sum below zero is reported as zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Effect", "VarianceParts", "variance_parts"]

Effect = tuple[str, ...]  # the factors of a random effect, in their order


@dataclass(frozen=True)
class VarianceParts:
    """Variances of random effects, in the square of the scores' unit, by the factors they need."""

    mean: float
    levels: dict[str, int]  # of each factor with at least two levels
    variances: dict[Effect, float]  # unbiased estimates, which may be negative

    def deviation(self, *effects: Effect) -> float:
        """Standard deviation of the sum of these effects; nan if none was measured."""
        known = [self.variances[effect] for effect in effects if effect in self.variances]
        return math.sqrt(max(0.0, sum(known))) if known else math.nan

    def standard_error(self, *fresh: str) -> float:
        """Standard error of the mean, if the factors in `fresh` were drawn anew.

        All others stay as they are, so effects without a fresh factor do not count: a claim about
        other scenes needs `fresh="scene"`. Nan if one of `fresh` was measured at one level only.
        """
        if not set(fresh) <= self.levels.keys():
            return math.nan
        shares = [
            variance / math.prod(self.levels[factor] for factor in effect)
            for effect, variance in self.variances.items()
            if set(effect) & set(fresh)
        ]
        return math.sqrt(max(0.0, sum(shares)))


def variance_parts(scores: NDArray[np.float64], factors: Sequence[str]) -> VarianceParts:
    """Estimate the parts of `scores`, an array with one axis for each of `factors`.

    Factors with one level are left out. Raises ValueError for an array with other axes, or a nan.

    >>> parts = variance_parts(np.array([[1.0, 1.2], [3.0, 3.2]]), ("scene", "order"))
    >>> round(parts.deviation(("scene",)), 3), round(parts.deviation(("order",)), 3)
    (1.414, 0.141)
    """
    if scores.ndim != len(factors) or np.isnan(scores).any():
        raise ValueError(
            f"scores have {scores.ndim} axes for {len(factors)} factors, and "
            f"{np.isnan(scores).sum()} of them are nan; give one score for each combination"
        )
    levels = {f: n for f, n in zip(factors, scores.shape, strict=True) if n > 1}
    table = scores.reshape(tuple(levels.values()))
    effects = list(_subsets(tuple(levels)))
    squares = {effect: _mean_square(table, tuple(levels), effect) for effect in effects}
    variances = {}
    for effect in effects:
        # E[MS of u] = sum over v that contain u of var(v) x the levels outside v: inclusion and
        # exclusion over the sets above u gives var(u)
        above = [other for other in effects if set(effect) <= set(other)]
        signed = sum((-1) ** (len(other) - len(effect)) * squares[other] for other in above)
        outside = math.prod(n for factor, n in levels.items() if factor not in effect)
        variances[effect] = float(signed / outside)
    return VarianceParts(float(scores.mean()), levels, variances)


def _subsets(factors: Effect) -> Iterator[Effect]:
    """All sets of factors but the empty one, small ones first."""
    for size in range(1, len(factors) + 1):
        yield from combinations(factors, size)


def _mean_square(table: NDArray[np.float64], factors: Effect, effect: Effect) -> float:
    """Mean square of an effect: the squared interaction contrast by its degrees of freedom."""
    contrast = table
    for axis, factor in enumerate(factors):
        mean = contrast.mean(axis=axis, keepdims=True)
        contrast = contrast - mean if factor in effect else np.broadcast_to(mean, contrast.shape)
    freedom = math.prod(table.shape[factors.index(factor)] - 1 for factor in effect)
    return float((contrast**2).sum() / freedom)

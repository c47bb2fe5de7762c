"""The best method within a deadline at a cost of a sample, and where another takes its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reports.analysis.curves import Curve

__all__ = [
    "NOTHING",
    "Switch",
    "Winners",
    "find_switches",
    "find_winners",
    "meeting_costs",
    "meeting_deadlines",
]

Numbers = NDArray[np.float64]
NOTHING = -1  # in place of a method where none fits
STEPS = 8  # places that are examined between two meeting points
BISECTIONS = 60  # more than a double has bits


@dataclass(frozen=True, eq=False)
class Winners:
    """For each of n pairs of deadline and cost: the methods that fit, the best one first."""

    order: NDArray[np.intp]  # [methods n], indices of the curves, best first
    spp: Numbers  # [methods n], best budget of each curve; nan where it does not fit
    values: Numbers  # [methods n], score at that budget

    @property
    def first(self) -> NDArray[np.intp]:
        """Index of the winner's curve, [n], or NOTHING."""
        return self._place(0)

    @property
    def second(self) -> NDArray[np.intp]:
        """Index of the runner-up's curve, [n], or NOTHING."""
        return self._place(1)

    def _place(self, rank: int) -> NDArray[np.intp]:
        if rank >= len(self.order):
            return np.full(self.order.shape[1], NOTHING)
        index = self.order[rank]
        fits = ~np.isnan(np.take_along_axis(self.spp, index[None], axis=0)[0])
        return np.where(fits, index, NOTHING)


@dataclass(frozen=True)
class Switch:
    """A place where the label changes from `before` to `after` as x grows."""

    at: float
    before: int
    after: int


def find_winners(curves: Sequence[Curve], sample_ms: Numbers, deadline_ms: Numbers) -> Winners:
    """Order the curves at each pair of cost [n] and deadline [n]; equal scores by their order."""
    spp = np.stack([curve.best_spp(sample_ms, deadline_ms) for curve in curves])
    values = np.stack([curve.value_at(s) for curve, s in zip(curves, spp, strict=True)])
    scores = np.where(np.isnan(values), -np.inf, curves[0].sign * values)
    return Winners(np.argsort(-scores, axis=0, kind="stable"), spp, values)


def find_switches(
    label: Callable[[Numbers], NDArray[np.intp]], points: Sequence[float]
) -> list[Switch]:
    """The places where a label of x > 0 changes, from the smallest to the largest of `points`.

    `points` are the places where the label may begin to behave differently (`meeting_deadlines`). A
    change and its reversal within an eighth of the way between two of them is not seen.
    """
    known = np.unique([x for x in points if 0 < x < np.inf])
    if len(known) == 0:
        return []
    inner = np.linspace(np.log(known[:-1]), np.log(known[1:]), STEPS, endpoint=False)
    x = np.unique(np.concatenate([np.exp(inner).ravel(), known, known[:1] / 2, known[-1:] * 2]))
    labels = label(x)
    (places,) = np.nonzero(labels[:-1] != labels[1:])
    low, high, before = x[places], x[places + 1], labels[places]
    for _ in range(BISECTIONS if len(places) else 0):
        middle = (low + high) / 2
        is_before = label(middle) == before
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    after = label(high) if len(places) else before
    parts = zip(high, before, after, strict=True)
    return [Switch(float(at), int(first), int(second)) for at, first, second in parts]


def meeting_deadlines(curves: Sequence[Curve], sample_ms: float) -> list[float]:
    """Deadlines that measured budgets just meet at this cost of a sample, ms."""
    return [float(time) for curve in curves for time in curve.frame_ms(sample_ms)]


def meeting_costs(curves: Sequence[Curve], deadline_ms: float) -> list[float]:
    """Costs of a sample at which measured budgets just meet this deadline, ms."""
    with np.errstate(divide="ignore", invalid="ignore"):
        costs = [(deadline_ms - curve.fixed_ms) / curve.samples for curve in curves]
    return [float(cost) for part in costs for cost in part]

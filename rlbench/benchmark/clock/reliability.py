"""Which times may be believed: the interval of a median, and the reason against a time."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import TypeVar

__all__ = [
    "ACCEPTED",
    "FLOOR_MS",
    "LEVEL",
    "TARGET",
    "half_width",
    "is_steady",
    "median_ranks",
    "middle_half",
    "unreliable_reason",
]

T = TypeVar("T")
LEVEL = 0.95  # of the interval of the median
TARGET = 0.02  # half width of the interval, relative to the median, at which measuring stops
ACCEPTED = 0.05  # largest half width of a time that may be believed
FLOOR_MS = 0.05  # a half width that is small enough for any time


def median_ranks(count: int, level: float = LEVEL) -> tuple[int, int] | None:
    """Ranks (from 0) of the order statistics that enclose the median with probability `level`.

    They hold for any distribution (Conover 1999, Practical Nonparametric Statistics, section 3.2).
    None for fewer values than such an interval needs.

    >>> median_ranks(6), median_ranks(20), median_ranks(5)
    ((0, 5), (5, 14), None)
    """
    tail, low = 0.0, -1
    while low < count:
        tail += math.comb(count, low + 1) / 2**count
        if tail > (1 - level) / 2:
            break
        low += 1
    return (low, count - 1 - low) if low >= 0 else None


def half_width(times: Sequence[float]) -> float:
    """Half the width of the interval of the median, in the units of `times`; inf for too few."""
    ranks = median_ranks(len(times))
    if ranks is None:
        return math.inf
    ordered = sorted(times)
    return (ordered[ranks[1]] - ordered[ranks[0]]) / 2


def is_steady(times: Sequence[float], target: float = TARGET) -> bool:
    """Is the median of these times, in milliseconds, known well enough?"""
    if not times:
        return False
    return half_width(times) <= max(FLOOR_MS, target * statistics.median(times))


def middle_half(ordered: Sequence[T]) -> Sequence[T]:
    """The items between the quartiles of an ordered sequence; at least one.

    >>> middle_half([1, 2, 3, 4, 5, 6, 7, 8])
    [3, 4, 5, 6]
    """
    cut = len(ordered) // 4
    return ordered[cut : len(ordered) - cut]


def unreliable_reason(
    times: Sequence[float], counted: int, rounds: int, min_rounds: int, busy: str
) -> str:
    """Why the median of `times` must not be believed; empty if it may.

    `counted` of `rounds` rounds ran on a quiet machine; `busy` says how busy it was otherwise.
    """
    if counted < min_rounds:
        return f"the machine was busy in {rounds - counted} of {rounds} rounds ({busy})"
    if is_steady(times, ACCEPTED):
        return ""
    share = half_width(times) / statistics.median(times)
    return (
        f"the {LEVEL:.0%} interval of the median is +-{share:.1%} after {counted} rounds, "
        f"above {ACCEPTED:.0%}"
    )

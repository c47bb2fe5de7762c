"""The points of a curve whose times rise with the budget."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["longest_rise"]


def longest_rise(times: Sequence[float]) -> list[int]:
    """Positions of the longest part of `times` that rises; of equal ones, that which ends first.

    More samples take more time. Where a measured time falls as the budget grows, a busy machine
    disturbed one of the two points; a line through the others does not run backwards.

    >>> longest_rise([10.0, 30.0, 20.0, 25.0, 40.0])
    [0, 2, 3, 4]
    """
    chains: list[list[int]] = []
    for i, time in enumerate(times):
        before = [chain for chain in chains if times[chain[-1]] <= time]
        chains.append([*max(before, key=len, default=[]), i])
    return max(chains, key=len, default=[])

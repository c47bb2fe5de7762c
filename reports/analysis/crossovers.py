"""Crossovers: the frame time at which one method of a pair passes the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import Curve
from reports.analysis.intervals import interval_ends
from reports.analysis.winner import NOTHING, find_switches, find_winners, meeting_deadlines

__all__ = ["crossovers"]

GRID = 33  # deadlines from the shortest to the longest, to find where a pair is resolved
GRID_DRAWS = 1000  # of the bootstrap at each; the grid is coarser than what they scatter

COLUMNS = ("method", "other", "at_ms", "low_ms", "high_ms", "value", "spp", "other_spp")


def crossovers(
    curves: Sequence[Curve], sample_ms: float, seed: int = 0, draws: int = GRID_DRAWS
) -> pd.DataFrame:
    """Frame times at which, of each pair of methods, one passes the other.

    Each method has its best budget within that time. Columns method, other, at_ms, low_ms, high_ms,
    value, and the budgets of both there: `method` has the better score beyond `at_ms`, `other`
    below it; from low_ms to high_ms the paired interval of their difference includes zero (0: from
    the first time that fits both; inf: to any longer time). A pair without a row has one leader
    wherever both fit.
    """
    records = []
    for pair in combinations(curves, 2):
        points = meeting_deadlines(pair, sample_ms)
        for switch in find_switches(_leader_of(pair, sample_ms), points):
            if NOTHING in (switch.before, switch.after):
                continue
            passing, passed = pair[switch.after], pair[switch.before]
            at = (np.array(sample_ms), np.array(switch.at))
            spp = [float(curve.best_spp(*at)) for curve in (passing, passed)]
            low, high = _unresolved_times(pair, sample_ms, switch.at, points, seed, draws)
            records.append(
                {
                    "method": passing.method,
                    "other": passed.method,
                    "at_ms": switch.at,
                    "low_ms": low,
                    "high_ms": high,
                    "value": float(passing.value_at(np.array(spp[0]))),
                    "spp": spp[0],
                    "other_spp": spp[1],
                }
            )
    return pd.DataFrame(records, columns=list(COLUMNS)).sort_values("at_ms", ignore_index=True)


def _leader_of(
    pair: Sequence[Curve], sample_ms: float
) -> Callable[[NDArray[np.float64]], NDArray[np.intp]]:
    def leader(deadlines: NDArray[np.float64]) -> NDArray[np.intp]:
        winners = find_winners(pair, np.full_like(deadlines, sample_ms), deadlines)
        return np.where(winners.second == NOTHING, NOTHING, winners.first)

    return leader


def _unresolved_times(
    pair: Sequence[Curve],
    sample_ms: float,
    at_ms: float,
    points: Sequence[float],
    seed: int,
    draws: int,
) -> tuple[float, float]:
    """The times around `at_ms` at which the paired interval includes zero; nan without one."""
    times = np.geomspace(max(min(points), max(points) / 1e4), max(points), GRID)
    times = np.sort(np.append(times, at_ms))
    costs = np.full_like(times, sample_ms)
    first, second = (curve.units_at(curve.best_spp(costs, times)) for curve in pair)
    low, high = interval_ends((first - second).T, seed, draws)
    here = int(np.searchsorted(times, at_ms))
    if np.isnan(low[here]):
        return math.nan, math.nan
    (resolved,) = np.nonzero((low > 0) | (high < 0))
    (absent,) = np.nonzero(np.isnan(low))
    before = [int(i) for i in resolved if i < here]
    after = [int(i) for i in resolved if i > here]
    is_cut = bool(before) and not any(before[-1] < i < here for i in absent)
    return float(times[before[-1]]) if is_cut else 0.0, (
        float(times[after[0]]) if after else math.inf
    )

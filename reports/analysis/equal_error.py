"""Methods at equal error: the spp and the frame time that each needs for a given score."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import Curve
from reports.analysis.intervals import interval_ends

__all__ = ["SPP_COLUMNS", "TIME_COLUMNS", "Reach", "at_equal_error", "spp_to_reach"]

GRID = 33  # budgets from the smallest to the largest measured one, to invert an interval
GRID_DRAWS = 1000  # of the bootstrap at each; the grid is coarser than what they scatter

SPP_COLUMNS = ("spp", "spp_low", "spp_high")

TIME_COLUMNS = ("frame_ms", "frame_low_ms", "frame_high_ms")


@dataclass(frozen=True)
class Reach:
    """The budget at which a method reaches a score, and the interval of that budget.

    0 stands for "below the smallest measured budget", inf for "not by the largest".
    """

    spp: float
    low: float
    high: float


def at_equal_error(
    curves: Sequence[Curve],
    targets: Mapping[float, NDArray[np.float64]],  # [units] of each: scores of scenes or clips
    sample_ms: float,
    seed: int = 0,
    draws: int = GRID_DRAWS,
) -> pd.DataFrame:
    """The spp and the frame time at which each method has the mean score of each target.

    Columns method, target (its key), spp, spp_low, spp_high, frame_ms, frame_low_ms, frame_high_ms;
    a budget of 0 or inf as in `Reach`, whose times are nan.
    """
    records = []
    for target, scores in targets.items():
        for curve in curves:
            reach = spp_to_reach(curve, scores, seed, draws)
            budgets = np.array([reach.spp, reach.low, reach.high])
            times = curve.frame_ms_at(np.where(np.isfinite(budgets), budgets, np.nan), sample_ms)
            record = {"method": curve.method, "target": target}
            record |= dict(zip(SPP_COLUMNS, budgets.tolist(), strict=True))
            records.append(record | dict(zip(TIME_COLUMNS, times.tolist(), strict=True)))
    return pd.DataFrame(records)


def spp_to_reach(
    curve: Curve,
    target: NDArray[np.float64],  # [units], the scores to reach, of the same scenes or clips
    seed: int = 0,
    draws: int = GRID_DRAWS,
) -> Reach:
    """The smallest budget at which the mean score is at least that of `target`.

    The interval holds the budgets at which the paired interval of the difference includes zero.
    """
    positive = curve.spp[curve.spp > 0]
    if len(positive) == 0:
        return Reach(math.inf, math.inf, math.inf)
    grid = np.unique(np.concatenate([np.geomspace(positive[0], positive[-1], GRID), positive]))
    grid = grid.clip(positive[0], positive[-1])  # geomspace may miss its ends by a rounding
    gaps = curve.sign * (curve.units_at(grid) - target)
    low, high = interval_ends(gaps.T, seed, draws)
    mean = gaps.mean(axis=1)
    return Reach(*(_first_crossing(grid, gap) for gap in (mean, high, low)))


def _first_crossing(grid: NDArray[np.float64], gaps: NDArray[np.float64]) -> float:
    """Where gaps first reach zero, linear in log spp; 0 at the first place, inf if never."""
    if np.isnan(gaps).any():
        return math.nan
    (places,) = np.nonzero(gaps >= 0)
    if len(places) == 0:
        return math.inf
    place = int(places[0])
    if place == 0:
        return float(grid[0]) if gaps[0] == 0 else 0.0
    share = -gaps[place - 1] / (gaps[place] - gaps[place - 1])
    return float(grid[place - 1] * (grid[place] / grid[place - 1]) ** share)

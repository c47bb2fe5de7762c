"""Methods at equal time and at equal error: crossovers, spp and time to an error, at a deadline."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import Curve
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, Interval, interval_ends
from reports.analysis.method_names import family_of
from reports.analysis.ranking import name_verdict
from reports.analysis.winner import NOTHING, find_switches, find_winners, meeting_points

__all__ = [
    "SPP_COLUMNS",
    "TIME_COLUMNS",
    "Reach",
    "at_deadlines",
    "at_equal_error",
    "crossovers",
    "nice_deadlines",
    "with_half_the_samples",
    "spp_to_reach",
]

GRID = 33  # budgets, or deadlines, from the smallest to the largest, to invert an interval
GRID_DRAWS = 1000  # of the bootstrap at each; the grid is coarser than what they scatter
MAX_DEADLINES = 7
SERIES = ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1,))  # round times, the fewest where there are many


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
        points = meeting_points(pair, sample_ms=sample_ms)
        for switch in find_switches(_leader_of(pair, sample_ms), points):
            if NOTHING in (switch.before, switch.after):
                continue
            passing, passed = pair[switch.after], pair[switch.before]
            spp = [_best(curve, sample_ms, switch.at) for curve in (passing, passed)]
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
    columns = ["method", "other", "at_ms", "low_ms", "high_ms", "value", "spp", "other_spp"]
    return pd.DataFrame(records, columns=columns).sort_values("at_ms", ignore_index=True)


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


def nice_deadlines(curves: Sequence[Curve], sample_ms: float) -> list[float]:
    """At most MAX_DEADLINES round times between the shortest and the longest measured frame, ms."""
    times = np.array([time for curve in curves for time in curve.frame_ms(sample_ms)])
    low, high = times.min(), times.max()
    decades = range(math.floor(math.log10(max(low, 1e-3))), math.ceil(math.log10(high)) + 1)
    inner: list[float] = []
    for steps in SERIES:
        series = [step * 10.0**decade for decade in decades for step in steps]
        inner = [time for time in series if low <= time <= high] or [float(high)]
        if len(inner) <= MAX_DEADLINES:
            break
    return inner[-MAX_DEADLINES:]


def at_deadlines(
    curves: Sequence[Curve],
    sample_ms: float,
    deadlines: Sequence[float],
    unit: str = "dB",
    late: bool = False,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """The score of each method at its best budget within each deadline, and what the best gains.

    Columns method, deadline_ms, spp, value, difference, low, high (to the best method, paired by
    scene), verdict, best. `late`: the frame time has the p95 of plan + denoise, so that about one
    frame in 20 is late.
    """
    records = []
    for deadline in deadlines:
        spp = {c.method: _best(c, sample_ms, deadline, late) for c in curves}
        fits = [curve for curve in curves if not math.isnan(spp[curve.method])]
        if not fits:
            continue
        units = {c.method: c.units_at(np.array(spp[c.method])) for c in fits}
        best = max(fits, key=lambda c: c.sign * units[c.method].mean()).method
        for method, scores in units.items():
            gap = _interval(scores - units[best], seed, draws)
            records.append(
                {
                    "method": method,
                    "deadline_ms": deadline,
                    "spp": spp[method],
                    "value": float(scores.mean()),
                    **_ends(gap, is_known=method != best),
                    "verdict": name_verdict(gap, unit) if method != best else "",
                    "best": method == best,
                }
            )
    return pd.DataFrame(records)


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


def with_half_the_samples(
    curves: Sequence[Curve],
    base: Curve,
    sample_ms: float,
    unit: str = "dB",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """`base` at each budget against the best method of another family at twice that budget.

    Columns method, spp, rival, rival_spp, difference, low, high, verdict, frame_ms, rival_ms and
    speedup = rival_ms / frame_ms.
    """
    rivals = [curve for curve in curves if family_of(curve.method) != family_of(base.method)]
    return pd.DataFrame(
        [
            _half(base, rival, spp, sample_ms, unit, seed, draws)
            for spp in base.spp
            if (rival := _best_at(rivals, 2 * spp)) and spp > 0
        ]
    )


def _half(
    base: Curve, rival: Curve, spp: float, sample_ms: float, unit: str, seed: int, draws: int
) -> dict[str, object]:
    at, twice = np.array(spp), np.array(2 * spp)
    gap = _interval(base.units_at(at) - rival.units_at(twice), seed, draws)
    frame_ms = float(base.frame_ms_at(at, sample_ms))
    rival_ms = float(rival.frame_ms_at(twice, sample_ms))
    return {
        "method": base.method,
        "spp": float(spp),
        "rival": rival.method,
        "rival_spp": 2 * float(spp),
        **_ends(gap),
        "verdict": name_verdict(gap, unit),
        "frame_ms": frame_ms,
        "rival_ms": rival_ms,
        "speedup": rival_ms / frame_ms,
    }


def _best_at(curves: Sequence[Curve], spp: float) -> Curve | None:
    """The curve with the best score at a measured budget; None if none has it."""
    measured = [curve for curve in curves if spp in curve.spp]
    scores = {c.method: c.sign * float(c.value_at(np.array(spp))) for c in measured}
    return max(measured, key=lambda curve: scores[curve.method], default=None)


def _best(curve: Curve, sample_ms: float, deadline_ms: float, late: bool = False) -> float:
    return float(curve.best_spp(np.array(sample_ms), np.array(deadline_ms), late))


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


def _interval(units: NDArray[np.float64], seed: int, draws: int) -> Interval:
    low, high = interval_ends(units[:, None], seed, draws)
    return Interval(float(units.mean()), float(low[0]), float(high[0]), len(units))


def _ends(gap: Interval, is_known: bool = True) -> dict[str, float]:
    ends = {"difference": gap.mean, "low": gap.low, "high": gap.high}
    return ends if is_known else dict.fromkeys(ends, math.nan)

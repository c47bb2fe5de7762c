"""Methods at equal time and at equal error: in a deadline, at a crossover, at a score."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import (
    NOTHING,
    Curve,
    Numbers,
    curves_of,
    find_switches,
    find_winners,
    measured_sample_ms,
    meeting_deadlines,
)
from reports.analysis.differences import correct_by_holm, difference_columns
from reports.analysis.intervals import UNKNOWN, interval_ends, interval_of
from reports.analysis.rows import family_of
from reports.analysis.scores import ENDS, Scores

MAX_DEADLINES = 7
SERIES = ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1,))  # round times, the fewest where there are many
GRID = 33  # budgets or deadlines from the least to the largest, to invert an interval
GRID_DRAWS = 1000  # of the bootstrap at each; the grid is coarser than what they scatter
AT_MOST = 0.98  # a frame that takes a smaller share of the time could draw more samples
CROSSOVER = ["method", "other", "at_ms", "low_ms", "high_ms", "value", "spp", "other_spp"]
SPP_COLUMNS = ("spp", "spp_low", "spp_high")
TIME_COLUMNS = ("frame_ms", "frame_low_ms", "frame_high_ms")


def nice_deadlines(curves: Sequence[Curve], sample_ms: float) -> list[float]:
    """At most MAX_DEADLINES round times between the shortest and the longest measured frame, ms."""
    times = meeting_deadlines(curves, sample_ms)
    low, high = min(times), max(times)
    decades = range(math.floor(math.log10(max(low, 1e-3))), math.ceil(math.log10(high)) + 1)
    inner: list[float] = []
    for steps in SERIES:
        series = [step * 10.0**decade for decade in decades for step in steps]
        inner = [time for time in series if low <= time <= high] or [high]
        if len(inner) <= MAX_DEADLINES:
            break
    return inner[-MAX_DEADLINES:]


def at_deadlines(
    curves: Sequence[Curve], sample_ms: float, deadlines: Sequence[float], late: bool = False
) -> pd.DataFrame:
    """The score of each method at its best budget within each deadline, and what the best gains.

    Columns method, deadline_ms, spp, value, best, those of `difference_columns` (to the best
    method, paired by scene), and value_range: half of the range of the value over the interval of
    the method's time, 0 where it is narrow, nan where it does not fit at the high end. `late`: the
    frame time has the p95 of inference, so that about one frame in 20 is late.
    """
    records = []
    for deadline in deadlines:
        at = (np.array(sample_ms), np.array(deadline), late)
        spp = {curve.method: float(curve.best_spp(*at)) for curve in curves}
        fits = [curve for curve in curves if not math.isnan(spp[curve.method])]
        if not fits:
            continue
        units = {c.method: c.units_at(np.array(spp[c.method])) for c in fits}
        best = max(fits, key=lambda c: c.sign * units[c.method].mean()).method
        ranges = {c.method: _value_range(c, sample_ms, deadline) for c in fits}
        for method, scores in units.items():
            gap = UNKNOWN if method == best else interval_of(scores - units[best])
            records.append(
                {
                    **{"method": method, "deadline_ms": deadline, "spp": spp[method]},
                    "value": float(scores.mean()),
                    **difference_columns(gap, "dB", fits[0].direction),
                    "best": method == best,
                    "value_range": ranges[method],
                }
            )
    return pd.DataFrame(records)


def _value_range(curve: Curve, sample_ms: float, deadline: float) -> float:
    ends = [curve.at_end(end) for end in ENDS]
    spp = [end.best_spp(np.array(sample_ms), np.array(deadline)) for end in ends]
    worst, best = sorted(float(curve.value_at(each)) for each in spp)
    return (best - worst) / 2


def at_equal_latency(scores: Scores, rows: Sequence[str], base_name: str) -> pd.DataFrame:
    """Each of `rows` in the frame time that the base, one of them, has at each of its budgets.

    Empty without times of the base. In the order of `rows`.

    Columns method, base_spp, deadline_ms, spp (the best budget in this time, between the measured
    ones; nan: none fits), share (of the base's samples), uncertainty (the largest of the row's and
    the base's times), is_bound (more samples would fit than were measured), value, and those of
    `difference_columns` (value minus the base's, paired by scene).
    """
    known = {curve.method: curve for curve in curves_of(scores)}
    base = known.get(base_name)
    if base is None:
        return pd.DataFrame()
    sample_ms = np.array(measured_sample_ms(scores))
    records = []
    for base_spp, deadline in zip(base.spp, base.frame_ms(sample_ms), strict=True):
        for curve in (known[row] for row in rows if row in known):
            is_base = curve is base
            spp = base_spp if is_base else float(curve.best_spp(sample_ms, np.array(deadline)))
            units = curve.units_at(np.array(spp))
            gap = UNKNOWN
            if not is_base and not math.isnan(spp):
                gap = interval_of(units - base.units_at(np.array(base_spp)))
            records.append(
                {
                    "method": curve.method,
                    "base_spp": float(base_spp),
                    "deadline_ms": float(deadline),
                    "spp": spp,
                    "share": spp / base_spp,
                    "uncertainty": max(each.uncertainty(sample_ms) for each in (curve, base)),
                    "is_bound": not is_base and curve.frame_ms(sample_ms)[-1] < AT_MOST * deadline,
                    "value": float(units.mean()),
                    **difference_columns(gap),
                }
            )
    return correct_by_holm(pd.DataFrame(records))


def with_half_the_samples(curves: Sequence[Curve], base: Curve, sample_ms: float) -> pd.DataFrame:
    """`base` at each budget against the best method of another family at twice that budget.

    Columns method, spp, rival, rival_spp, those of `difference_columns`, frame_ms, rival_ms and
    speedup = rival_ms / frame_ms.
    """
    rivals = [curve for curve in curves if family_of(curve.method) != family_of(base.method)]
    records = []
    for spp in base.spp[base.spp > 0]:
        at, twice = np.array(spp), np.array(2 * spp)
        measured = [curve for curve in rivals if 2 * spp in curve.spp]
        if not measured:
            continue
        rival = max(measured, key=lambda curve: curve.sign * float(curve.value_at(twice)))
        gap = interval_of(base.units_at(at) - rival.units_at(twice))
        frame_ms = float(base.frame_ms_at(at, sample_ms))
        rival_ms = float(rival.frame_ms_at(twice, sample_ms))
        records.append(
            {
                **{"method": base.method, "spp": float(spp)},
                **{"rival": rival.method, "rival_spp": 2 * float(spp)},
                **difference_columns(gap, "dB", base.direction),
                **{"frame_ms": frame_ms, "rival_ms": rival_ms, "speedup": rival_ms / frame_ms},
            }
        )
    return pd.DataFrame(records)


def crossovers(curves: Sequence[Curve], sample_ms: float) -> pd.DataFrame:
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
            spp, other_spp = (float(curve.best_spp(*at)) for curve in (passing, passed))
            ends = _unresolved_times(pair, sample_ms, switch.at, points)
            value = float(passing.value_at(np.array(spp)))
            names = (passing.method, passed.method)
            records.append((*names, switch.at, *ends, value, spp, other_spp))
    return pd.DataFrame(records, columns=CROSSOVER).sort_values("at_ms", ignore_index=True)


def _leader_of(pair: Sequence[Curve], sample_ms: float) -> Callable[[Numbers], NDArray[np.intp]]:
    def leader(deadlines: Numbers) -> NDArray[np.intp]:
        winners = find_winners(pair, np.full_like(deadlines, sample_ms), deadlines)
        return np.where(winners.second == NOTHING, NOTHING, winners.first)

    return leader


def _unresolved_times(
    pair: Sequence[Curve], sample_ms: float, at_ms: float, points: Sequence[float]
) -> tuple[float, float]:
    """The times around `at_ms` at which the paired interval includes zero; nan without one."""
    times = np.geomspace(max(min(points), max(points) / 1e4), max(points), GRID)
    times = np.sort(np.append(times, at_ms))
    costs = np.full_like(times, sample_ms)
    first, second = (curve.units_at(curve.best_spp(costs, times)) for curve in pair)
    low, high = interval_ends((first - second).T, draws=GRID_DRAWS)
    here = int(np.searchsorted(times, at_ms))
    if np.isnan(low[here]):
        return math.nan, math.nan
    is_resolved, is_absent = (low > 0) | (high < 0), np.isnan(low)
    before = np.flatnonzero(is_resolved[:here])
    after = np.flatnonzero(is_resolved[here + 1 :])
    is_cut = len(before) > 0 and not is_absent[before[-1] + 1 : here].any()
    start = float(times[before[-1]]) if is_cut else 0.0
    return start, float(times[here + 1 + after[0]]) if len(after) else math.inf


class Reach(NamedTuple):
    """The budget at which a method reaches a score, and the interval of that budget.

    0 stands for "below the smallest measured budget", inf for "not by the largest".
    """

    spp: float
    low: float
    high: float


def at_equal_error(
    curves: Sequence[Curve], targets: Mapping[float, Numbers], sample_ms: float
) -> pd.DataFrame:
    """The spp and the frame time at which each method has the mean score of each target.

    `targets` has scores of scenes or clips [units] of each. Columns method, target (its key), spp,
    spp_low, spp_high, frame_ms, frame_low_ms, frame_high_ms; a budget of 0 or inf as in `Reach`,
    whose times are nan.
    """
    records = []
    for target, scores in targets.items():
        for curve in curves:
            budgets = np.array(spp_to_reach(curve, scores))
            times = curve.frame_ms_at(np.where(np.isfinite(budgets), budgets, np.nan), sample_ms)
            record = {"method": curve.method, "target": target}
            record |= dict(zip(SPP_COLUMNS, budgets.tolist(), strict=True))
            records.append(record | dict(zip(TIME_COLUMNS, times.tolist(), strict=True)))
    return pd.DataFrame(records)


def spp_to_reach(curve: Curve, target: Numbers) -> Reach:
    """The smallest budget at which the mean score is at least that of `target` [units].

    The interval holds the budgets at which the paired interval of the difference includes zero.
    """
    positive = curve.spp[curve.spp > 0]
    if len(positive) == 0:
        return Reach(math.inf, math.inf, math.inf)
    grid = np.unique(np.concatenate([np.geomspace(positive[0], positive[-1], GRID), positive]))
    grid = grid.clip(positive[0], positive[-1])  # geomspace may miss its ends by a rounding
    gaps = curve.sign * (curve.units_at(grid) - target)
    low, high = interval_ends(gaps.T, draws=GRID_DRAWS)
    return Reach(*(_first_crossing(grid, gap) for gap in (gaps.mean(axis=1), high, low)))


def _first_crossing(grid: Numbers, gaps: Numbers) -> float:
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

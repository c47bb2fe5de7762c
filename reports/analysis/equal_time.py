"""Methods at equal time: the score of each at its best budget within a deadline."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from reports.analysis.curves import Curve
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, interval_of
from reports.analysis.method_names import family_of
from reports.analysis.multiplicity import difference_columns

__all__ = ["at_deadlines", "nice_deadlines", "with_half_the_samples"]

MAX_DEADLINES = 7

SERIES = ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1,))  # round times, the fewest where there are many


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

    Columns method, deadline_ms, spp, value, best, and those of `difference_columns` (to the best
    method, paired by scene). `late`: the frame time has the p95 of inference, so that about
    one frame in 20 is late.
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
        for method, scores in units.items():
            gap = UNKNOWN if method == best else interval_of(scores - units[best], seed, draws)
            records.append(
                {
                    "method": method,
                    "deadline_ms": deadline,
                    "spp": spp[method],
                    "value": float(scores.mean()),
                    **difference_columns(gap, unit, fits[0].direction),
                    "best": method == best,
                }
            )
    return pd.DataFrame(records)


def with_half_the_samples(
    curves: Sequence[Curve],
    base: Curve,
    sample_ms: float,
    unit: str = "dB",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """`base` at each budget against the best method of another family at twice that budget.

    Columns method, spp, rival, rival_spp, those of `difference_columns`, frame_ms, rival_ms and
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
    gap = interval_of(base.units_at(at) - rival.units_at(twice), seed, draws)
    frame_ms = float(base.frame_ms_at(at, sample_ms))
    rival_ms = float(rival.frame_ms_at(twice, sample_ms))
    return {
        "method": base.method,
        "spp": float(spp),
        "rival": rival.method,
        "rival_spp": 2 * float(spp),
        **difference_columns(gap, unit, base.direction),
        "frame_ms": frame_ms,
        "rival_ms": rival_ms,
        "speedup": rival_ms / frame_ms,
    }


def _best_at(curves: Sequence[Curve], spp: float) -> Curve | None:
    """The curve with the best score at a measured budget; None if none has it."""
    measured = [curve for curve in curves if spp in curve.spp]
    scores = {c.method: c.sign * float(c.value_at(np.array(spp))) for c in measured}
    return max(measured, key=lambda curve: scores[curve.method], default=None)

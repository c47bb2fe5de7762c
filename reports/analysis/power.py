"""The smallest difference that a number of scenes can resolve."""

from __future__ import annotations

import math
from functools import cache

from scipy import optimize, stats

from reports.analysis.intervals import LEVEL

__all__ = ["POWER", "smallest_resolvable", "standardised_resolvable"]

POWER = 0.8  # chance that a difference of that size is resolved, with its sign
MAX_EFFECT = 30.0  # standard deviations; two units resolve 11 with power 80 %


def smallest_resolvable(
    deviation: float, units: int, level: float = LEVEL, power: float = POWER
) -> float:
    """The difference whose `level` interval excludes zero with probability `power`.

    `deviation` is the standard deviation of the paired differences between units, in the unit of
    the result. The interval is Student's t, the differences normal. Nan with fewer than two units.

    >>> round(smallest_resolvable(0.2, 4), 3)
    0.426
    """
    return deviation * standardised_resolvable(units, level, power)


@cache
def standardised_resolvable(units: int, level: float = LEVEL, power: float = POWER) -> float:
    """The same in standard deviations (Cohen 1988, Statistical Power Analysis, chapter 2)."""
    if units < 2:
        return math.nan
    critical = float(stats.t.isf((1 - level) / 2, units - 1))

    def missing_power(effect: float) -> float:
        return float(stats.nct.sf(critical, units - 1, effect * math.sqrt(units))) - power

    return float(optimize.brentq(missing_power, 0.0, MAX_EFFECT))

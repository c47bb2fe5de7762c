"""Paired differences between methods, their confidence intervals over scenes, and their power."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import optimize, stats

Numbers = NDArray[np.float64]
FRAME = ("scene", "clip", "frame")  # columns that identify a frame
BOOTSTRAP_SAMPLES = 10_000  # the ends of a 95 % interval are then stable to about 1 %
LEVEL = 0.95  # of confidence
POWER = 0.8  # chance that a difference of the smallest resolvable size is resolved, with its sign
MAX_EFFECT = 30.0  # standard deviations; two units resolve 11 with power 80 %
MIN_BOOTSTRAP_UNITS = 8  # scenes or clips; below it the interval is Student's t
COLUMNS_AT_ONCE = 64  # that are resampled together; bounds the memory
INTERVAL_NOTE = (
    "95 % interval over scenes (over clips if there is one scene; Student's t below "
    f"{MIN_BOOTSTRAP_UNITS} of them, BCa bootstrap from there on)"
)


@dataclass(frozen=True)
class Interval:
    """A mean and its confidence interval; the ends are nan with fewer than two units."""

    mean: float
    low: float
    high: float
    units: int  # scenes, or clips of the only scene
    deviation: float = math.nan  # standard deviation of the units, n - 1 in the denominator

    @property
    def is_known(self) -> bool:
        """True if there are enough units for an interval."""
        return not math.isnan(self.low)

    @property
    def excludes_zero(self) -> bool:
        """True if the interval excludes zero; False if it is unknown."""
        return self.low > 0 or self.high < 0

    def is_within(self, margin: float) -> bool:
        """True if the interval lies within +-margin; False if it is unknown."""
        return -margin <= self.low and self.high <= margin

    @property
    def p_value(self) -> float:
        """Two-sided p of Student's t-test that the mean is zero; nan where it is unknown.

        It is Student's also where the interval is the bootstrap's: a correction for many
        comparisons needs levels that 10 000 draws do not resolve.
        """
        if not self.is_known or math.isnan(self.deviation):
            return math.nan
        if self.deviation == 0:
            return float(self.mean == 0)
        t = self.mean / self.deviation * math.sqrt(self.units)
        return 2 * float(stats.t.sf(abs(t), self.units - 1))


UNKNOWN = Interval(math.nan, math.nan, math.nan, 0)


def pair(method: pd.DataFrame, other: pd.DataFrame, by: Sequence[str] = FRAME) -> pd.DataFrame:
    """Scores of `method` minus those of `other` in the same frame.

    Both tables have the columns `by` and value, and so does the result. Frames that only one table
    has are left out.
    """
    on = list(by)
    both = method[[*on, "value"]].merge(other[[*on, "value"]], on=on, validate="one_to_one")
    return both[on].assign(value=both["value_x"] - both["value_y"])


def unit_means(values: pd.DataFrame) -> pd.Series[float]:
    """Means of the independent units: of scenes, or of the clips of the only scene.

    `values` has the columns scene, clip and value, one row per frame. Each clip has equal weight in
    its scene. Frames of a clip, and clips of a scene, are correlated.
    """
    clips: pd.Series[float] = values.groupby(["scene", "clip"])["value"].mean()
    scenes: pd.Series[float] = clips.groupby("scene").mean()
    return scenes if len(scenes) > 1 else clips


def mean_with_interval(
    values: pd.DataFrame, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES
) -> Interval:
    """Mean over scenes and its confidence interval; of a single scene, over its clips.

    `values` is as in `unit_means`; each scene has equal weight in the mean.
    """
    return interval_of(np.asarray(unit_means(values), np.float64), seed, draws)


def interval_of(units: Numbers, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> Interval:
    """Mean of independent numbers [units] with its confidence interval, as `interval_ends`.

    >>> interval = interval_of(np.array([0.1, 0.2, 0.3, 0.4]))
    >>> f"{interval.mean:.2f} [{interval.low:.2f}, {interval.high:.2f}]"
    '0.25 [0.04, 0.46]'
    """
    return intervals_of(units[:, None], seed, draws)[0]


def intervals_of(units: Numbers, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> list[Interval]:
    """The mean of each column of [units columns] with its interval; all columns one bootstrap."""
    count, columns = units.shape
    means = units.mean(axis=0) if count else np.full(columns, math.nan)
    deviations = units.std(axis=0, ddof=1) if count > 1 else np.full(columns, math.nan)
    ends = np.stack([means, *interval_ends(units, seed, draws)]).T.tolist()
    return [
        Interval(mean, low, high, count, deviation)
        for (mean, low, high), deviation in zip(ends, deviations.tolist(), strict=True)
    ]


def interval_ends(
    units: Numbers, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES
) -> tuple[Numbers, Numbers]:
    """Low and high ends [columns] of the interval of each column's mean, of units [units columns].

    Below MIN_BOOTSTRAP_UNITS units the interval is Student's t: resampling so few cannot reach
    beyond their extremes (with four normal units the truth lies within the extremes 87 % of the
    time). From there on it is the bias-corrected and accelerated bootstrap (Efron 1987, Better
    Bootstrap Confidence Intervals), which follows a skewed distribution. Its level is widened as
    Hesterberg 2015 (What Teachers Should Know About the Bootstrap, section on the expanded
    percentile interval) does for percentiles; without it, eight normal units cover 87 %. Where BCa
    is undefined, as with equal units, the interval is Student's t.

    All columns are resampled alike. The ends are nan with fewer than two units, and of a column
    with a nan.
    """
    low, high = np.full((2, units.shape[1]), math.nan)
    is_known = ~np.isnan(units).any(axis=0)
    if len(units) > 1 and is_known.any():
        low[is_known], high[is_known] = _ends(units[:, is_known], seed, draws)
    return low, high


def _ends(units: Numbers, seed: int, draws: int) -> tuple[Numbers, Numbers]:
    # not ttest_1samp(...).confidence_interval: its ends are nan where all units are equal
    standard_errors = float(stats.t.ppf((1 + LEVEL) / 2, len(units) - 1))
    half_width = standard_errors * units.std(axis=0, ddof=1) / math.sqrt(len(units))
    low, high = units.mean(axis=0) - half_width, units.mean(axis=0) + half_width
    if len(units) < MIN_BOOTSTRAP_UNITS:
        return low, high
    for first in range(0, units.shape[1], COLUMNS_AT_ONCE):
        part = slice(first, first + COLUMNS_AT_ONCE)
        ends = _bca_ends(units[:, part], standard_errors, seed, draws)
        is_defined = ~np.isnan(ends).any(axis=0)
        low[part][is_defined], high[part][is_defined] = ends[:, is_defined]
    return low, high


def _bca_ends(units: Numbers, standard_errors: float, seed: int, draws: int) -> Numbers:
    """Ends [2 columns] of the widened BCa interval; nan where it is undefined."""
    count = len(units)
    tail = float(stats.norm.cdf(-math.sqrt(count / (count - 1)) * standard_errors))
    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        ends = stats.bootstrap(
            (units,),
            np.mean,
            n_resamples=draws,
            confidence_level=1 - 2 * tail,
            method="BCa",
            rng=np.random.default_rng(seed),
        ).confidence_interval
    return np.stack([ends.low, ends.high])


def smallest_resolvable(deviation: float, units: int) -> float:
    """The difference whose 95 % interval excludes zero with probability POWER.

    `deviation` is the standard deviation of the paired differences between units, in the unit of
    the result. The interval is Student's t, the differences normal. Nan with fewer than two units.

    >>> round(smallest_resolvable(0.2, 4), 3)
    0.426
    """
    return deviation * standardised_resolvable(units)


@cache
def standardised_resolvable(units: int) -> float:
    """The same in standard deviations (Cohen 1988, Statistical Power Analysis, chapter 2)."""
    if units < 2:
        return math.nan
    critical = float(stats.t.isf((1 - LEVEL) / 2, units - 1))

    def missing_power(effect: float) -> float:
        return float(stats.nct.sf(critical, units - 1, effect * math.sqrt(units))) - POWER

    return float(optimize.brentq(missing_power, 0.0, MAX_EFFECT))

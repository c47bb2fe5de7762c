"""Paired differences between methods and their confidence intervals over scenes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

__all__ = [
    "BOOTSTRAP_SAMPLES",
    "FRAME",
    "INTERVAL_NOTE",
    "LEVEL",
    "UNKNOWN",
    "Interval",
    "interval_ends",
    "mean_with_interval",
    "pair",
]

FRAME = ("scene", "clip", "frame")  # columns that identify a frame
BOOTSTRAP_SAMPLES = 10_000  # the ends of a 95 % interval are then stable to about 1 %
LEVEL = 0.95  # of confidence
MIN_BOOTSTRAP_UNITS = 8  # scenes or clips; below it the interval is Student's t
COLUMNS_AT_ONCE = 64  # that are resampled together; bounds the memory
INTERVAL_NOTE = (
    "95 % interval over scenes (over clips if there is one scene; Student's t below "
    f"{MIN_BOOTSTRAP_UNITS} of them, bootstrap from there on)"
)


@dataclass(frozen=True)
class Interval:
    """A mean and its confidence interval; the ends are nan with fewer than two units."""

    mean: float
    low: float
    high: float
    units: int  # scenes, or clips of the only scene

    @property
    def is_resolved(self) -> bool:
        """Whether the interval excludes zero; true where the interval is unknown."""
        return not self.low <= 0 <= self.high

    def is_tie(self, margin: float) -> bool:
        """Whether the interval lies within +-margin; false where the interval is unknown."""
        return -margin <= self.low and self.high <= margin


UNKNOWN = Interval(math.nan, math.nan, math.nan, 0)


def pair(method: pd.DataFrame, other: pd.DataFrame, by: Sequence[str] = FRAME) -> pd.DataFrame:
    """Scores of `method` minus those of `other` in the same frame.

    Both tables have the columns `by` and value, and so does the result. Frames that only one table
    has are left out.
    """
    on = list(by)
    both = method[[*on, "value"]].merge(other[[*on, "value"]], on=on, validate="one_to_one")
    return both[on].assign(value=both["value_x"] - both["value_y"])


def mean_with_interval(
    values: pd.DataFrame, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES, level: float = LEVEL
) -> Interval:
    """Mean over scenes and its confidence interval; of a single scene, over its clips.

    `values` has the columns scene, clip and value, one row per frame. Each clip has equal weight in
    its scene, and each scene in the mean. Frames of a clip, and clips of a scene, are correlated;
    the independent units are the scenes, or the clips of the only scene.

    Below MIN_BOOTSTRAP_UNITS units the interval is Student's t: resampling so few cannot reach
    beyond their extremes (with four normal units the truth lies within the extremes 87 % of the
    time). From there on it is the percentile bootstrap, which follows a skewed distribution, with
    the wider percentiles of Hesterberg 2015, What Teachers Should Know About the Bootstrap, section
    on the expanded percentile interval.
    """
    clips = values.groupby(["scene", "clip"])["value"].mean()
    scenes = clips.groupby("scene").mean()
    units = (scenes if len(scenes) > 1 else clips).to_numpy(float)
    mean = float(units.mean()) if len(units) else math.nan
    low, high = interval_ends(units[:, None], seed, draws, level)
    return Interval(mean, float(low[0]), float(high[0]), len(units))


def interval_ends(
    units: NDArray[np.float64],  # [units columns], the independent numbers of each column
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
    level: float = LEVEL,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high ends [columns] of the interval of each column's mean, as `mean_with_interval`.

    All columns are resampled alike. The ends are nan with fewer than two units, and of a column
    with a nan.
    """
    low, high = np.full((2, units.shape[1]), math.nan)
    is_known = ~np.isnan(units).any(axis=0)
    if len(units) > 1 and is_known.any():
        low[is_known], high[is_known] = _ends(units[:, is_known], seed, draws, level)
    return low, high


def _ends(
    units: NDArray[np.float64], seed: int, draws: int, level: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    count, columns = units.shape
    standard_errors = float(stats.t.ppf((1 + level) / 2, count - 1))
    if count < MIN_BOOTSTRAP_UNITS:
        # not ttest_1samp(...).confidence_interval: its ends are nan where all units are equal
        half_width = standard_errors * units.std(axis=0, ddof=1) / math.sqrt(count)
        return units.mean(axis=0) - half_width, units.mean(axis=0) + half_width
    tail = float(stats.norm.cdf(-math.sqrt(count / (count - 1)) * standard_errors))
    parts = [
        stats.bootstrap(
            (units[:, first : first + COLUMNS_AT_ONCE],),
            np.mean,
            n_resamples=draws,
            confidence_level=1 - 2 * tail,
            method="percentile",
            rng=np.random.default_rng(seed),
        ).confidence_interval
        for first in range(0, columns, COLUMNS_AT_ONCE)
    ]
    return np.concatenate([p.low for p in parts]), np.concatenate([p.high for p in parts])

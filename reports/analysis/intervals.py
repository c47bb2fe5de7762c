"""How sure a difference is: paired by frame, as scenes differ, and a tie is called a tie."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import pandas as pd
from scipy.special import stdtrit

SHOT = ("scene", "clip", "frame")

DRAWS = 10_000  # bootstrap samples: the ends of a 95 % interval are then stable to about 1 %
LEVEL = 0.95
FEW = 8  # scenes or clips: fewer are not resampled
INTERVAL_NOTE = f"95 % interval over scenes (of one scene, over clips; Student's t below {FEW})"


@dataclass(frozen=True)
class Interval:
    """A mean and where it may lie; the ends are nan where one alone tells nothing."""

    mean: float
    low: float
    high: float
    units: int  # scenes, or clips of one

    @property
    def tie(self) -> bool:
        """Does the interval include zero? Never where it is unknown."""
        return self.low <= 0 <= self.high


UNKNOWN = Interval(math.nan, math.nan, math.nan, 0)


def paired(method: pd.DataFrame, other: pd.DataFrame, by: Sequence[str] = SHOT) -> pd.DataFrame:
    """Scores of `method` less those of `other`, frame by frame.

    Both have the columns `by` and value; so has the result. Frames that only one of them has are
    left out.
    """
    on = list(by)
    both = method[[*on, "value"]].merge(other[[*on, "value"]], on=on, validate="one_to_one")
    return both[on].assign(value=both["value_x"] - both["value_y"])


def interval(
    values: pd.DataFrame, seed: int = 0, draws: int = DRAWS, level: float = LEVEL
) -> Interval:
    """Mean over scenes, and where it may lie for other scenes; of one scene, for other clips of it.

    Frames of a clip, and clips of a scene, are alike: what is independent are scenes, or the clips
    of the only one. `values` has the columns scene, clip and value, a row a frame; each clip weighs
    the same in its scene, and each scene the same. Below FEW of them the interval is Student's t,
    since resampling so few cannot reach beyond their extremes (four normal ones: the truth is
    within the extremes 87 % of the time); from there on the percentile bootstrap, its percentiles
    spread as in Hesterberg 2015, What Teachers Should Know About the Bootstrap, section on the
    expanded percentile interval, which follows a skewed distribution.
    """
    clips = values.groupby(["scene", "clip"])["value"].mean()
    scenes = clips.groupby("scene").mean()
    score = (scenes if len(scenes) > 1 else clips).to_numpy(float)
    count, mean = len(score), float(score.mean()) if len(score) else math.nan
    if count < 2:
        return Interval(mean, math.nan, math.nan, count)
    if count < FEW:
        half = _t(count, level) * float(score.std(ddof=1)) / math.sqrt(count)
        return Interval(mean, mean - half, mean + half, count)
    drawn = np.random.default_rng(seed).integers(count, size=(draws, count))
    tail = NormalDist().cdf(-math.sqrt(count / (count - 1)) * _t(count, level))
    low, high = np.quantile(score[drawn].mean(axis=1), [tail, 1 - tail])
    return Interval(mean, float(low), float(high), count)


def _t(count: int, level: float) -> float:
    """How many standard errors Student's t reaches."""
    return float(stdtrit(count - 1, (1 + level) / 2))

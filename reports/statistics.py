"""How sure a difference is: paired by frame, resampled by clip, and a tie is called a tie."""

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


@dataclass(frozen=True)
class Interval:
    """A mean and where it may lie; the ends are nan where one clip alone tells nothing."""

    mean: float
    low: float
    high: float
    clips: int

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
    """Mean over scenes, and its percentile bootstrap interval over clips.

    Frames of a clip are not independent, so whole clips are drawn, with replacement; each scene
    weighs the same. `values` has the columns scene, clip and value, a row a frame. The percentiles
    are spread for few clips as in Hesterberg 2015, What Teachers Should Know About the Bootstrap,
    section on the expanded percentile interval. Below about six clips the interval cannot reach
    beyond the extremes of the clips, and so is too short.
    """
    clips = values.groupby(["scene", "clip"], as_index=False)["value"].mean()
    count = len(clips)
    if not count:
        return UNKNOWN
    score = clips["value"].to_numpy(float)
    weight = 1 / clips.groupby("scene")["value"].transform("size").to_numpy(float)
    mean = float(np.average(score, weights=weight))
    if count == 1:
        return Interval(mean, math.nan, math.nan, 1)
    drawn = np.random.default_rng(seed).integers(count, size=(draws, count))
    means = np.average(score[drawn], weights=weight[drawn], axis=1)
    tail = _tail(count, level)
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(mean, float(low), float(high), count)


def _tail(count: int, level: float) -> float:
    """Share of bootstrap means left out at either end: Phi(-sqrt(n / (n - 1)) t)."""
    t = float(stdtrit(count - 1, (1 + level) / 2))
    return NormalDist().cdf(-math.sqrt(count / (count - 1)) * t)

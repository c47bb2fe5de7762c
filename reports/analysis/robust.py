"""Robust aggregates of scores [runs scenes]: interquartile mean, improvement, profile.

The definitions are those of Agarwal et al. 2021 (Deep Reinforcement Learning at the Edge of the
Statistical Precipice, section 4) and of their library rliable; a scene takes the place of a task,
an order of samples that of a run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

__all__ = ["interquartile_mean", "performance_profile", "probability_of_improvement"]

Scores = NDArray[np.float64]  # [runs scenes]


def interquartile_mean(scores: Scores) -> float:
    """Mean of the middle half of all runs and scenes: one bad scene moves it little.

    >>> interquartile_mean(np.array([[-40.0, 1.0, 2.0, 9.0]]))
    1.5
    """
    return float(stats.trim_mean(scores, proportiontocut=0.25, axis=None))


def probability_of_improvement(first: Scores, second: Scores) -> float:
    """Chance that a run of `first` scores higher than one of `second` on the same random scene.

    Equal scores count half. Both have the same scenes; their runs may differ in number.

    >>> probability_of_improvement(np.array([[2.0, 2.0, 1.0]]), np.array([[1.0, 3.0, 1.0]]))
    0.5
    """
    signs = np.sign(first[:, None] - second[None])  # runs runs scenes
    return float((signs + 1).mean() / 2)


def performance_profile(scores: Scores, thresholds: Sequence[float]) -> list[float]:
    """Share of runs and scenes whose score is above each threshold.

    >>> performance_profile(np.array([[0.0, 0.2, 0.4, 0.6]]), [0.0, 0.5])
    [0.75, 0.25]
    """
    return [float((scores > threshold).mean()) for threshold in thresholds]

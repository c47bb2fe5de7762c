"""Differences between two methods that were each trained several times with other seeds."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from scipy import stats

from reports.analysis.intervals import LEVEL
from reports.analysis.method_names import training_series_of, without_label

__all__ = ["BASE", "differences_to"]

BASE = "ours"  # the method that others are compared with, if it was trained several times
COLUMNS = ("series", "target_spp", "difference", "difference_low", "difference_high")


def differences_to(means: pd.DataFrame, base: str = BASE, level: float = LEVEL) -> pd.DataFrame:
    """Mean of each series of trainings minus the mean of the trainings of `base`, per budget.

    `means` has the columns method, target_spp and value, one row per training. `difference_low` and
    `difference_high` are the interval of Welch's t-test (Welch 1947), which assumes normal,
    independent trainings and allows unequal variances. Series are compared if their labels differ
    only in the number; at least two trainings of each are needed at a budget.
    """
    records = []
    for (label, spp), part in means.groupby([means["method"].map(_label_word), "target_spp"]):
        trainings = dict(list(part.groupby(part["method"].map(without_label))["value"]))
        ours = trainings.pop(base, pd.Series(dtype=float))
        for row, theirs in trainings.items():
            if min(len(ours), len(theirs)) > 1:
                low, high = _welch_interval(theirs.to_numpy(), ours.to_numpy(), level)
                difference = theirs.mean() - ours.mean()
                records.append((f"{row}@{label}", spp, difference, low, high))
    return pd.DataFrame(records, columns=list(COLUMNS))


def _welch_interval(first: np.ndarray, second: np.ndarray, level: float) -> tuple[float, float]:
    """The interval of the difference of two means."""
    # scipy gives nan where neither side varies; then the difference is exact
    if math.isclose(first.std() + second.std(), 0.0, abs_tol=1e-12):
        return (first.mean() - second.mean(),) * 2
    ends = stats.ttest_ind(first, second, equal_var=False).confidence_interval(level)
    return float(ends.low), float(ends.high)


def _label_word(method: str) -> str:
    """The label without the number at its end."""
    return training_series_of(method).partition("@")[2]

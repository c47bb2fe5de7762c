"""Differences between two methods that were each trained several times with other seeds."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from scipy import stats

from reports.analysis.intervals import LEVEL, Interval
from reports.analysis.method_names import training_series_of, without_label
from reports.analysis.multiplicity import correct_by_holm
from reports.analysis.verdicts import name_verdict

__all__ = ["BASE", "differences_to"]

BASE = "ours"  # the method that others are compared with, if it was trained several times
COLUMNS = (
    "series", "target_spp", "difference", "difference_low", "difference_high", "p_value", "verdict",
)  # fmt: skip


def differences_to(means: pd.DataFrame, base: str = BASE, level: float = LEVEL) -> pd.DataFrame:
    """Mean of each series of trainings minus the mean of the trainings of `base`, per budget.

    `means` has the columns method, target_spp and value, one row per training. `difference_low` and
    `difference_high` are the interval of Welch's t-test (Welch 1947), which assumes normal,
    independent trainings and allows unequal variances. Series are compared if their labels differ
    only in the number; at least two trainings of each are needed at a budget. `p_value` is that of
    the test, `p_holm` and `mark` its correction over all differences.
    """
    records = []
    for (label, spp), part in means.groupby([means["method"].map(_label_word), "target_spp"]):
        trainings = dict(list(part.groupby(part["method"].map(without_label))["value"]))
        ours = trainings.pop(base, pd.Series(dtype=float))
        for row, theirs in trainings.items():
            if min(len(ours), len(theirs)) > 1:
                low, high, p = _welch_test(theirs.to_numpy(), ours.to_numpy(), level)
                gap = Interval(theirs.mean() - ours.mean(), low, high, len(theirs) + len(ours))
                verdict = name_verdict(gap, "dB")
                records.append((f"{row}@{label}", spp, gap.mean, low, high, p, verdict))
    return correct_by_holm(pd.DataFrame(records, columns=list(COLUMNS)))


def _welch_test(first: np.ndarray, second: np.ndarray, level: float) -> tuple[float, float, float]:
    """The ends of the interval of the difference of two means, and the p-value that it is zero."""
    # scipy gives nan where neither side varies; then the difference is exact
    if math.isclose(first.std() + second.std(), 0.0, abs_tol=1e-12):
        difference = first.mean() - second.mean()
        return difference, difference, float(difference == 0)
    test = stats.ttest_ind(first, second, equal_var=False)
    ends = test.confidence_interval(level)
    return float(ends.low), float(ends.high), float(test.pvalue)


def _label_word(method: str) -> str:
    """The label without the number at its end."""
    return training_series_of(method).partition("@")[2]

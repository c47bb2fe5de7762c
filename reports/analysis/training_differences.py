"""Is one row better than another whatever the seed of training? Differences between trainings."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from scipy import stats

from reports.analysis import method_names
from reports.analysis.intervals import LEVEL

BASE = "ours"  # row that others are held against, where it was trained several times


def differences_to(means: pd.DataFrame, base: str = BASE, level: float = LEVEL) -> pd.DataFrame:
    """A row for each series of trainings and budget, its mean less that of `base`'s trainings.

    `means` has a row for each training: columns method, spp, value. `difference_low` and
    `difference_high` are the interval of Welch's t-test (Welch 1947), which takes trainings to be
    normal and independent and lets the spreads differ. Compared are rows whose weights have one
    name but for the number; a side with fewer than two trainings at a budget is left out.
    """
    made = []
    for (words, spp), part in means.groupby([means["method"].map(_words), "target_spp"]):
        trained = dict(list(part.groupby(part["method"].map(method_names.row))["value"]))
        ours = trained.pop(base, pd.Series(dtype=float))
        for row, theirs in trained.items():
            if min(len(ours), len(theirs)) > 1:
                low, high = _welch(theirs.to_numpy(), ours.to_numpy(), level)
                made.append(
                    {
                        "series": f"{row}@{words}",
                        "target_spp": spp,
                        "difference": theirs.mean() - ours.mean(),
                        "difference_low": low,
                        "difference_high": high,
                    }
                )
    return pd.DataFrame(
        made, columns=["series", "target_spp", "difference", "difference_low", "difference_high"]
    )


def _welch(one: np.ndarray, other: np.ndarray, level: float) -> tuple[float, float]:
    """The interval of the difference of two means; their difference itself where none varies."""
    if math.isclose(one.std() + other.std(), 0.0, abs_tol=1e-12):
        return (one.mean() - other.mean(),) * 2
    found = stats.ttest_ind(one, other, equal_var=False).confidence_interval(level)
    return float(found.low), float(found.high)


def _words(method: str) -> str:
    """The name of the weights without its number."""
    return method_names.training_series(method).partition("@")[2]

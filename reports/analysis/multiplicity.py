"""Holm's correction of all differences of a page, and sentences on what the page can resolve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.intervals import LEVEL, Interval
from reports.analysis.power import POWER, smallest_resolvable
from reports.analysis.verdicts import HOLM_MARK, LEADS, TRAILS, name_verdict

__all__ = ["correct_by_holm", "difference_columns", "difference_notes", "holm"]


def difference_columns(
    gap: Interval, unit: str = "dB", direction: str = "higher"
) -> dict[str, object]:
    """A difference as columns of a record: its interval, verdict, p and what could be resolved."""
    return {
        "difference": gap.mean,
        "low": gap.low,
        "high": gap.high,
        "verdict": name_verdict(gap, unit, direction),
        "p_value": gap.p_value,
        "unit": unit,
        "resolvable": smallest_resolvable(gap.deviation, gap.units),
    }


def holm(p_values: Sequence[float]) -> NDArray[np.float64]:
    """Adjusted p-values [n] of Holm 1979 (A Simple Sequentially Rejective Multiple Test Procedure).

    The smallest is multiplied by n, the next by n - 1, and so on; none is below an earlier one, nor
    above 1. A nan is no comparison and stays nan.

    >>> holm([0.01, 0.04, 0.03]).round(4).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, float)
    adjusted = np.full_like(p, np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.maximum.accumulate(np.minimum(p[order] * factors, 1.0))
    return adjusted


def correct_by_holm(records: pd.DataFrame) -> pd.DataFrame:
    """The records of a page with `p_holm`, and `mark` where the correction takes the lead away."""
    p_holm = holm(list(records["p_value"]))
    is_lead = records["verdict"].isin([LEADS, TRAILS])
    mark = np.where(is_lead & (p_holm > 1 - LEVEL), HOLM_MARK, "")
    return records.assign(p_holm=p_holm, mark=mark)


def difference_notes(records: pd.DataFrame) -> list[str]:
    """What the differences of a page resolve, after `correct_by_holm`; empty without any."""
    compared = records[records["p_value"].notna()]
    if compared.empty:
        return []
    leads = compared[compared["verdict"].isin([LEADS, TRAILS])]
    kept = leads[leads["mark"] == ""]
    lines = [
        f"Holm's correction for the {len(compared)} differences of this page keeps {len(kept)} of "
        f"{len(leads)} leads at 5 % over all (p of the paired t-test); {HOLM_MARK} marks the others"
    ]
    sizes = records.loc[records["unit"] == "dB", "resolvable"].dropna()
    if len(sizes):
        lines.append(
            f"With power {POWER:.0%}, these clips resolve differences from {sizes.median():.2f} dB "
            f"(median; {sizes.min():.2f} to {sizes.max():.2f} dB, by how much a pair of methods "
            "varies between scenes)".replace("%", " %")
        )
    return lines

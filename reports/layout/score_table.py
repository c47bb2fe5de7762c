"""The table of a score: methods by budget, the best bold, and what is not resolved."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.ranking import ALL_SCENES
from reports.analysis.verdicts import LEADS, TRAILS, VERDICT_NOTE
from reports.layout.tables import Bold, Table, rank_rows

__all__ = ["score_table"]

RULES = {"higher": "Higher is better.", "lower": "Lower is better."}
NOTE = (
    "Methods are in the order of their scores at the budget nearest to 1 spp that most have. Bold "
    f"is best at its budget; others are compared with it. {VERDICT_NOTE}"
)
DIGITS = 3  # significant ones, of the median of a table without a unit
MAX_DECIMALS = 6


def score_table(scores: Scores, rank: pd.DataFrame, caption: str = "", subject: str = "") -> Table:
    """The rows of `rank_methods` of one scene, or of all: a row a method, a column a budget.

    Differences must have gone through `correct_by_holm`. `subject` replaces the metric in the
    title.
    """
    unit = scores.column_text("unit")
    number = _number_format(unit, rank["mean"])
    cells = {
        (row["method"], row["target_spp"]): _format_score(row, number)
        for row in rank.to_dict("records")
    }
    budgets = sorted(set(rank["target_spp"]))
    rows = tuple(
        (method, *(cells.get((method, spp), "-") for spp in budgets))
        for method in rank_rows(rank, "mean", scores.direction)
    )
    scenes = set(rank["scene"]) - {ALL_SCENES}
    title = (subject or scores.metric) + f" [{unit}]" * bool(unit)
    title += f", {scenes.pop() if scenes else 'mean over scenes'}"
    caption += RULES.get(scores.direction, "Not ranked.")
    header = ("method", *(f"{spp:g} spp" for spp in budgets))
    return Table(title, caption, header, rows, NOTE if scores.direction else "")


def _format_score(row: Mapping[Hashable, Any], number: Callable[[float], str]) -> str:
    mean, low, high = (row[name] for name in ("mean", "low", "high"))
    text = number(mean)
    if row["best"]:
        return Bold(text)
    if low == low:
        text += f" [{number(low)}, {number(high)}]{row['mark']}"
    return text if row["verdict"] in ("", LEADS, TRAILS) else f"{text} {row['verdict']}"


def _number_format(unit: str, values: pd.Series[float]) -> Callable[[float], str]:
    """Equal decimals in a table: two of dB and ms, else as many as its median needs."""
    sizes = values.abs()
    median = float(sizes[sizes > 0].median())
    decimals = 2
    if unit not in ("dB", "ms") and median == median:
        decimals = min(max(DIGITS - 1 - math.floor(math.log10(median)), 0), MAX_DECIMALS)
    return lambda value: f"{value:.{decimals}f}"

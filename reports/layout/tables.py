"""Tables of text, and their cells; written as Markdown here, as LaTeX in `latex`."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from reports.analysis.verdicts import LEADS, TRAILS

__all__ = [
    "UNRELIABLE_MARK",
    "UNRELIABLE_MEANING",
    "Bold",
    "Table",
    "format_difference",
    "format_ms",
    "format_samples",
    "pivot_by_budget",
    "rank_rows",
    "to_markdown",
]

UNRELIABLE_MARK = "?"  # after a time
UNRELIABLE_MEANING = "an unreliable time, see the list below and rlbench run --retime"


class Bold(str):
    """Text of a cell in bold type."""


@dataclass(frozen=True)
class Table:
    """A titled table: the first column is text, the others are numbers."""

    title: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""  # how to read it; a page prints it once for all tables that share it


def format_difference(record: Mapping[Hashable, Any]) -> str:
    """A signed difference with its interval and verdict; bold if one method leads.

    `record` has the columns of `difference_columns`, and `mark` if they were corrected.

    >>> format_difference({"difference": -0.5, "low": -1.5, "high": 0.5, "verdict": "not resolved"})
    '-0.50 [-1.50, +0.50] not resolved'
    """
    text = f"{record['difference']:+.2f}"
    if not record["verdict"]:
        return text
    text += f" [{record['low']:+.2f}, {record['high']:+.2f}]{record.get('mark', '')}"
    if record["verdict"] in (LEADS, TRAILS):
        return Bold(text)
    return f"{text} {record['verdict']}"


def format_ms(ms: float, unreliable: bool, decimals: int = 1, sign: str = "") -> str:
    """A time in milliseconds, marked if it is unreliable; `-` without one.

    >>> format_ms(3.14, unreliable=True), format_ms(3.14, unreliable=False, sign="+")
    ('3.1?', '+3.1')
    """
    if pd.isna(ms):
        return "-"
    return f"{ms:{sign}.{decimals}f}{UNRELIABLE_MARK * unreliable}"


def format_samples(record: Mapping[Hashable, Any]) -> str:
    """The samples per pixel of a row of `at_equal_latency`; `none` where no budget fits.

    >>> format_samples({"spp": 4.0, "is_bound": True, "unreliable": False})
    '>= 4.00'
    """
    if pd.isna(record["spp"]):
        return "none"
    mark = UNRELIABLE_MARK * bool(record["unreliable"])
    return f"{'>= ' * bool(record['is_bound'])}{record['spp']:.2f}{mark}"


def pivot_by_budget(
    records: pd.DataFrame,
    format_record: Callable[[Mapping[Hashable, Any]], str],
    order: Sequence[str],
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of a table: a row for each method of `order`, a column for each budget."""
    budgets = sorted(set(records["target_spp"]))
    cells = {
        (record["method"], record["target_spp"]): format_record(record)
        for record in records.to_dict("records")
    }
    rows = [(method, *(cells.get((method, spp), "-") for spp in budgets)) for method in order]
    return ("variant", *(f"{spp:g} spp" for spp in budgets)), rows


def rank_rows(records: pd.DataFrame, column: str, direction: str = "higher") -> list[str]:
    """The methods of `records`, best first at one budget: that which most have, nearest to 1 spp.

    Methods without a number there come last, by name. Without a direction the order is by name.

    >>> table = pd.DataFrame({"method": ["a", "b"], "target_spp": [1.0, 1.0], "psnr": [20.0, 21.0]})
    >>> rank_rows(table, "psnr"), rank_rows(table, "psnr", "lower")
    (['b', 'a'], ['a', 'b'])
    """
    names = sorted(set(records["method"]))
    known = records[records[column].notna()]
    counts = known.groupby("target_spp")["method"].nunique()
    if counts.empty or not direction:
        return names
    budgets = [float(spp) for spp in counts.index if counts[spp] == counts.max()]
    nearest = min(budgets, key=lambda spp: abs(math.log(spp)) if spp > 0 else math.inf)
    at = known[known["target_spp"] == nearest].groupby("method")[column].mean()
    sign = 1 if direction == "lower" else -1
    return sorted(names, key=lambda name: (name not in at, sign * at.get(name, 0.0), name))


def to_markdown(table: Table) -> str:
    """The table in GitHub's Markdown, its title as a heading and its caption as a paragraph."""
    rule = ["---", *["---:"] * (len(table.header) - 1)]
    lines = [[_markdown_cell(cell) for cell in row] for row in (table.header, *table.rows)]
    lines.insert(1, rule)
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return "\n\n".join(filter(None, [f"### {table.title}", table.caption, f"{body}\n"]))


def _markdown_cell(cell: str) -> str:
    text = cell.replace("|", "\\|")
    return f"**{text}**" if isinstance(cell, Bold) else text

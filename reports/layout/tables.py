"""Tables of text, written as Markdown and as LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
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
    "pivot_by_budget",
    "to_latex",
    "to_markdown",
]

UNRELIABLE_MARK = "?"  # after a time
UNRELIABLE_MEANING = "an unreliable time, see the list below and rlbench run --retime"

LATEX_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


class Bold(str):
    """Text of a cell in bold type."""


@dataclass(frozen=True)
class Table:
    """A titled table: the first column is text, the others are numbers."""

    title: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


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


def pivot_by_budget(
    records: pd.DataFrame, format_record: Callable[[Mapping[Hashable, Any]], str]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of a table with a row for each `method` and a column for each budget."""
    budgets = sorted(set(records["target_spp"]))
    cells = {
        (record["method"], record["target_spp"]): format_record(record)
        for record in records.to_dict("records")
    }
    rows = [
        (method, *(cells.get((method, spp), "-") for spp in budgets))
        for method in sorted(set(records["method"]))
    ]
    return ("variant", *(f"{spp:g} spp" for spp in budgets)), rows


def to_markdown(table: Table) -> str:
    """The table in GitHub's Markdown, its title as a heading and its caption as a paragraph."""
    rule = ["---", *["---:"] * (len(table.header) - 1)]
    lines = [[_markdown_cell(cell) for cell in row] for row in (table.header, *table.rows)]
    lines.insert(1, rule)
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"### {table.title}\n\n{table.caption}\n\n{body}\n"


def to_latex(table: Table) -> str:
    """The table as a LaTeX float; it needs the package booktabs."""
    lines = [" & ".join(map(_latex_cell, row)) + r" \\" for row in (table.header, *table.rows)]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_escape_latex(table.title)}. {_escape_latex(table.caption)}}}",
            rf"\begin{{tabular}}{{l{'r' * (len(table.header) - 1)}}}",
            r"\toprule",
            lines[0],
            r"\midrule",
            *lines[1:],
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _markdown_cell(cell: str) -> str:
    text = cell.replace("|", "\\|")
    return f"**{text}**" if isinstance(cell, Bold) else text


def _latex_cell(cell: str) -> str:
    return rf"\textbf{{{_escape_latex(cell)}}}" if isinstance(cell, Bold) else _escape_latex(cell)


def _escape_latex(text: str) -> str:
    return "".join(LATEX_ESCAPES.get(c, c) for c in text)

"""Tables of text, written as Markdown and as LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


class Bold(str):
    """Text of a cell that stands out."""


@dataclass(frozen=True)
class Grid:
    """A titled table: the first column is text, the others are numbers."""

    title: str
    caption: str
    head: tuple[str, ...]
    body: tuple[tuple[str, ...], ...]


def gap_text(mean: float, low: float, high: float, form: str = ".2f") -> str:
    """A difference with its interval in brackets, if that is known; bold where it excludes zero."""
    text = format(mean, f"+{form}")
    if low != low:
        return text
    text += f" [{low:+{form}}, {high:+{form}}]"
    return Bold(text) if low > 0 or high < 0 else text


def wide(
    found: pd.DataFrame, show: Callable[[Mapping[Hashable, Any]], str]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and lines of a table with a line for each `method` and a column for each budget."""
    budgets = sorted(set(found["target_spp"]))
    cells = {(row["method"], row["target_spp"]): show(row) for row in found.to_dict("records")}
    lines = [
        (method, *(cells.get((method, spp), "-") for spp in budgets))
        for method in sorted(set(found["method"]))
    ]
    return ("variant", *(f"{spp:g} spp" for spp in budgets)), lines


def markdown(grid: Grid) -> str:
    """The table as GitHub shows it, its title a heading and its caption a paragraph."""
    rule = ["---", *["---:"] * (len(grid.head) - 1)]
    lines = [[_marked(cell) for cell in line] for line in (grid.head, *grid.body)]
    lines.insert(1, rule)
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"### {grid.title}\n\n{grid.caption}\n\n{table}\n"


def latex(grid: Grid) -> str:
    """The table as a float that needs the package booktabs."""
    lines = [" & ".join(map(_typeset, line)) + r" \\" for line in (grid.head, *grid.body)]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_escaped(grid.title)}. {_escaped(grid.caption)}}}",
            rf"\begin{{tabular}}{{l{'r' * (len(grid.head) - 1)}}}",
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


def _marked(cell: str) -> str:
    text = cell.replace("|", "\\|")
    return f"**{text}**" if isinstance(cell, Bold) else text


def _typeset(cell: str) -> str:
    return rf"\textbf{{{_escaped(cell)}}}" if isinstance(cell, Bold) else _escaped(cell)


def _escaped(text: str) -> str:
    return "".join(ESCAPES.get(c, c) for c in text)

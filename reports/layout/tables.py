"""Tables of text and their cells, and the table of a score; LaTeX is in `latex`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from reports.analysis.differences import ALL_SCENES, LEADS, TRAILS, VERDICT_NOTE
from reports.analysis.rows import methods_from_elsewhere, nearest_budget
from reports.analysis.scores import Scores
from rlbench.benchmark.results import WIDE, interval_columns, mark_uncertainty, uncertainty

Record = Mapping[Hashable, Any]
Rows = tuple[tuple[str, ...], ...]
UNCERTAIN_MEANING = (
    "±: how far a quiet machine's time may be from it, where that is more than "
    f"{100 * WIDE:.0f} %; see the list below and rlbench run --times uncertain"
)
CLAIMED_MARK = "*"  # after a time that is claimed of images made elsewhere
SCORE_NAMES = {
    "psnr": "PSNR",
    "psnr_debiased": "PSNR, debiased",
    "psnr_late": "PSNR, late",
    "ms_ssim": "MS-SSIM",
    "ssim": "SSIM",
    "relmse": "relMSE",
    "rel_l2": "relL2",
    "smape": "SMAPE",
    "flip": "FLIP",
    "hdr_flip": "HDR-FLIP",
    "lpips": "LPIPS",
    "cvvdp": "ColorVideoVDP",
}  # as papers write them
RULES = {"higher": "Higher is better.", "lower": "Lower is better."}
SCORE_NOTE = (
    "Methods are sorted by their scores at the budget nearest to 1 spp that most methods have. The "
    f"best at each budget is bold; the others are compared with it. {VERDICT_NOTE}"
)
HTML = re.compile(r"<(?=[A-Za-z/!?])")  # the beginning of a tag or of a comment
DIGITS = 3  # significant ones, of the median of a table without a unit
MAX_DECIMALS = 6


def score_name(metric: str) -> str:
    """A metric as papers write it; the name of the results where they have no other."""
    return SCORE_NAMES.get(metric, metric)


class Bold(str):
    """Text of a cell in bold type."""


@dataclass(frozen=True)
class Table:
    """A titled table: the first column is text, the others are numbers."""

    title: str
    caption: str
    header: tuple[str, ...]
    rows: Rows
    note: str = ""  # how to read it; a page prints it once for all tables that share it
    beside: str = ""  # what follows a number in a cell, if that is not an interval of the number


def format_difference(record: Record) -> str:
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


def format_number(value: float, number_format: str) -> str:
    """The number, or `-` for nan."""
    return "-" if pd.isna(value) else format(value, number_format)


def uncertainty_of(row: Record, part: str = "frame") -> float:
    """The `uncertainty` of a time of `Scores.points` or `Scores.overall`; 0 without an interval."""
    return uncertainty(*(float(row[column]) for column in interval_columns(part)))


def format_ms(row: Record, part: str = "frame", decimals: int = 1) -> str:
    """A time of `Scores.points` in milliseconds, with its uncertainty where that is large.

    `-` without a time.

    >>> format_ms({"frame_ms": 3.14, "frame_low_ms": 2.5, "frame_high_ms": 3.5})
    '3.1 ±26 %'
    """
    ms = row[f"{part}_ms"]
    return "-" if pd.isna(ms) else f"{ms:.{decimals}f}{mark_uncertainty(uncertainty_of(row, part))}"


def pivot(
    records: pd.DataFrame,
    cell: Callable[[Record], str],
    order: Iterable[str],
    first: str = "method",
    column: str = "target_spp",
    heading: Callable[[float], str] = "{:g} spp".format,
) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of a table: a row for each method of `order`, a column for each budget.

    `first` is the title of the first column; `column` replaces the budget.
    """
    values = sorted(set(records[column])) if len(records) else []
    cells = {(row["method"], row[column]): cell(row) for row in records.to_dict("records")}
    rows = tuple((name, *(cells.get((name, value), "-") for value in values)) for name in order)
    return (first, *map(heading, values)), rows


def rank_rows(records: pd.DataFrame, column: str, direction: str = "higher") -> list[str]:
    """The methods of `records`, best first at one budget: that nearest to 1 spp which most have.

    Methods without a number there come last, by name. Without a direction the order is by name.

    >>> table = pd.DataFrame({"method": ["a", "b"], "target_spp": [1.0, 1.0], "psnr": [20.0, 21.0]})
    >>> rank_rows(table, "psnr"), rank_rows(table, "psnr", "lower")
    (['b', 'a'], ['a', 'b'])
    >>> rank_rows(pd.concat([table, table.assign(target_spp=2.0, method=["a", "c"])]), "psnr")
    ['b', 'a', 'c']
    """
    names = sorted(set(records["method"]))
    known = records[records[column].notna()]
    counts = known.groupby("target_spp")["method"].nunique()
    if counts.empty or not direction:
        return names
    budgets = [float(spp) for spp in counts.index if 2 * counts[spp] > counts.max()]
    at = known[known["target_spp"] == nearest_budget(budgets)].groupby("method")[column].mean()
    sign = 1 if direction == "lower" else -1
    return sorted(names, key=lambda name: (name not in at, sign * at.get(name, 0.0), name))


def score_table(scores: Scores, rank: pd.DataFrame, caption: str = "", subject: str = "") -> Table:
    """The rows of `rank_methods` of one scene, or of all: a row a method, a column a budget.

    Differences must have gone through `correct_by_holm`. `subject` replaces the metric in the
    title.
    """
    unit = scores.column_text("unit")
    number = _number_format(unit, rank["mean"])
    order = rank_rows(rank, "mean", scores.direction)
    header, rows = pivot(rank, lambda row: _format_score(row, number), order)
    scenes = set(rank["scene"]) - {ALL_SCENES}
    title = (subject or score_name(scores.metric)) + f" [{unit}]" * bool(unit)
    title += f", {scenes.pop() if scenes else 'mean over scenes'}"
    caption += RULES.get(scores.direction, "Not ranked.")
    if claimed := [m for m in methods_from_elsewhere(scores.rows) if m in order]:
        caption += f" Not verified, images and budget as claimed: {', '.join(claimed)}."
    note = SCORE_NOTE if scores.direction else ""
    return Table(title, caption, header, rows, note, beside="difference")


def _format_score(row: Record, number: Callable[[float], str]) -> str:
    text = number(row["mean"])
    if row["best"]:
        return Bold(text)
    if not pd.isna(row["low"]):
        text += f" [{number(row['low'])}, {number(row['high'])}]{row['mark']}"
    return text if row["verdict"] in ("", LEADS, TRAILS) else f"{text} {row['verdict']}"


def _number_format(unit: str, values: pd.Series[float]) -> Callable[[float], str]:
    """Equal decimals in a table: two of dB and ms, else as many as its median needs."""
    sizes = values.abs()
    median = float(sizes[sizes > 0].median())
    decimals = 2
    if unit not in ("dB", "ms") and median == median:
        decimals = min(max(DIGITS - 1 - math.floor(math.log10(median)), 0), MAX_DECIMALS)
    return lambda value: f"{value:.{decimals}f}"


def to_markdown(table: Table) -> str:
    """The table in GitHub's Markdown, its title as a heading and its caption as a paragraph."""
    header, *rows = ([escape_bars(cell) for cell in row] for row in (table.header, *table.rows))
    texts = [f"### {one_line(table.title)}", one_line(table.caption), pipe_table(header, rows)]
    return "\n\n".join(filter(None, texts))


def pipe_table(header: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = True) -> str:
    """A table of cells in Markdown; all columns but the first are aligned to the right.

    Without `numbers`, all are aligned to the left.
    """
    rule = ["---", *["---:" if numbers else "---"] * (len(header) - 1)]
    return "".join("| " + " | ".join(line) + " |\n" for line in (header, rule, *rows))


def one_line(text: str) -> str:
    """Text of the results for Markdown: on one line, and without HTML or links that they bring.

    >>> one_line("CPU\\n# <script> [x](http://y)")
    'CPU # &lt;script> [x]\\\\(http://y)'
    """
    return HTML.sub("&lt;", " ".join(text.split())).replace("](", "]\\(")


def escape_bars(cell: str) -> str:
    """The cell for a table of pipes; bold if it is `Bold`."""
    text = one_line(cell).replace("|", "\\|")
    return f"**{text}**" if isinstance(cell, Bold) else text

"""The stress matrix: the verdict of each method in each section, as pictures and tables.

Command: python -m reports.stress_matrix results/stress docs/results, after
rlbench stress. Writes stress.md, stress.png, and stress-SECTION.png for each section of methods.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd
from matplotlib.patches import Rectangle

from reports.layout.files import drawn_png
from reports.layout.style import BLACK
from reports.layout.tables import escape_bars, pipe_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUITE = "suite"  # row of the sections that concern no method
ORDER = ("failed", "degraded", "passed", "skipped")  # the worst first
BAD_PIXEL = "bad-pixel"  # section with a planted fault per test
COMMAND = "make stress"
MARKS = {"passed": "✓", "degraded": "!", "failed": "✗", "skipped": "–"}  # noqa: RUF001
# a light blue, a medium orange, a dark red: distinct for colour-blind readers and in grey
FILLS = {"passed": "#C5E3F3", "degraded": "#F0A830", "failed": "#9E2A0B", "skipped": "#F2F2F2"}
INK = {"passed": BLACK, "degraded": BLACK, "failed": "#FFFFFF", "skipped": "#777777"}
ROW_HEIGHT, NARROW, WIDE = 0.27, 0.27, 0.95  # inches; a wide column holds a count too
MIN_WIDTH = 4.0  # inches, of all columns: the key below them needs it
LABEL_WIDTH, HEAD_HEIGHT = 2.1, 1.7  # inches, of the names of rows and columns


class Cell(NamedTuple):
    """The verdict of a cell, and a text after its mark."""

    verdict: str
    text: str = ""


class Matrix(NamedTuple):
    """Results of `rlbench stress`, one row a test, methods and sections in their order."""

    results: pd.DataFrame

    @property
    def methods(self) -> list[str]:
        """Names of the methods, without `suite`."""
        return [name for name in dict.fromkeys(self.results["method"]) if name != SUITE]

    def sections(self, is_suite: bool = False) -> list[str]:
        """The sections that run for each method, or those of the suite."""
        rows = self.results[(self.results["method"] == SUITE) == is_suite]
        return list(dict.fromkeys(rows["section"]))

    def of_section(self, section: str) -> pd.DataFrame:
        """The results of a section."""
        return self.results[self.results["section"] == section]

    def summary(self, method: str, section: str) -> Cell | None:
        """The worst verdict, and how many of the tests passed; None without results."""
        rows = self.of_section(section)
        verdicts = rows.loc[rows["method"] == method, "verdict"]
        if verdicts.empty:
            return None
        worst = next(verdict for verdict in ORDER if (verdicts == verdict).any())
        run = verdicts[verdicts != "skipped"]
        return Cell(worst, f"{(run == 'passed').sum()}/{len(run)}" if len(run) else "")


def read_results(folder: Path) -> Matrix:
    """The table that `rlbench stress --out FOLDER` wrote."""
    texts = ("method", "section", "test", "verdict", "unit", "found", "remedy")
    results = pd.read_csv(
        folder / "stress.csv",
        dtype=dict.fromkeys(texts, str),
        keep_default_na=False,
        na_values={name: [""] for name in ("figure", "good", "fair")},
    )
    return Matrix(results.replace({"method": {"": SUITE}}))


def small_table(matrix: Matrix, methods: Sequence[str], is_suite: bool = False) -> str:
    """Markdown table of methods by sections: the worst verdict, and how many tests passed."""
    sections = matrix.sections(is_suite)
    rows = [
        [method, *(_format_cell(matrix.summary(method, section)) for section in sections)]
        for method in methods
    ]
    return _format_table(["", *sections], rows)


def write_page(matrix: Matrix, folder: Path) -> list[Path]:
    """Write the pictures and the page with all that did not pass; returns the files.

    What was found in each method, in words, is in `stress.csv` of the results.
    """
    folder.mkdir(parents=True, exist_ok=True)
    overview, page, sections = folder / "stress.png", folder / "stress.md", matrix.sections()
    pairs = [(method, section) for method in matrix.methods for section in sections]
    cells = {pair: cell for pair in pairs if (cell := matrix.summary(*pair))}
    draw_grid(cells, matrix.methods, sections, "Stress tests passed", overview)
    pictures = []
    for section in sections:
        rows = matrix.of_section(section)
        keys = zip(rows["method"], rows["test"], strict=True)
        marked = dict(zip(keys, map(Cell, rows["verdict"]), strict=True))
        pictures.append(folder / f"stress-{section}.png")
        tests = list(dict.fromkeys(rows["test"]))
        draw_grid(marked, matrix.methods, tests, f"Section {section}", pictures[-1])
    page.write_text("\n".join(_page(matrix)), encoding="utf-8")
    return [page, overview, *pictures]


def _page(matrix: Matrix) -> Iterator[str]:
    yield "# Stress tests\n"
    yield f"Written by `{COMMAND}`. [How to read a verdict](../how-to/stress-a-method.md). "
    yield "Below: tests that some methods did not pass; `stress.csv` says what was found in each.\n"
    yield "![Tests passed by each method in each section](stress.png)\n"
    if planted := _count_contained(matrix):
        yield f"{planted}.\n"
    yield small_table(matrix, matrix.methods)
    if matrix.sections(is_suite=True):
        yield small_table(matrix, [SUITE], is_suite=True)
    for section in matrix.sections():
        yield f"## {section}\n"
        yield f"![Verdict of each method in each test of {section}](stress-{section}.png)\n"
        yield _list_faults(matrix.of_section(section))
    for section in matrix.sections(is_suite=True):
        yield f"## {section}\n"
        yield _list_faults(matrix.of_section(section))


def _count_contained(matrix: Matrix) -> str:
    """`Planted bad pixels: N of M contained`; empty where none were planted."""
    rows = matrix.of_section(BAD_PIXEL)
    planted = rows[rows["unit"] == "pixels"]
    contained = (planted["verdict"] == "passed").sum()
    return f"Planted bad pixels: {contained} of {len(planted)} contained" if len(planted) else ""


def _list_faults(rows: pd.DataFrame) -> str:
    """A line for each test and verdict that is not passed: methods, figures and remedy."""
    faults = rows[rows["verdict"].isin(["failed", "degraded"])]
    if faults.empty:
        return "Every test passed.\n"
    order = [(verdict, test) for verdict in ORDER for test in dict.fromkeys(faults["test"])]
    groups = dict(list(faults.groupby(["verdict", "test"])))
    cells = [
        [
            *(test, MARKS[verdict], ", ".join(groups[verdict, test]["method"])),
            *(_format_figures(groups[verdict, test]), groups[verdict, test]["remedy"].iloc[0]),
        ]
        for verdict, test in order
        if (verdict, test) in groups
    ]
    return _format_table(["test", "verdict", "methods", "figures (limits)", "remedy"], cells)


def _format_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return pipe_table(head, [list(map(escape_bars, row)) for row in rows], numbers=False)


def _format_figures(rows: pd.DataFrame) -> str:
    """`0.3 to 2.1 dB (0.1, 1)`, with the limits of passed and degraded; empty without figures."""
    first, figures = rows.iloc[0], rows["figure"].dropna()
    limits = ", ".join(f"{first[name]:g}" for name in ("good", "fair") if not pd.isna(first[name]))
    ends = dict.fromkeys(f"{figure:.4g}" for figure in (figures.min(), figures.max()))
    text = f"{' to '.join(ends)} {first['unit']}".strip() if len(figures) else ""
    return f"{text} ({limits})" if limits else text


def _format_cell(cell: Cell | None) -> str:
    return f"{MARKS[cell.verdict]} {cell.text}".strip() if cell else ""


def draw_grid(
    cells: Mapping[tuple[str, str], Cell],
    rows: Sequence[str],
    columns: Sequence[str],
    title: str,
    file: Path,
) -> None:
    """Write a PNG with a coloured and marked cell for each (row, column); others stay empty."""
    width = WIDE if any(cell.text for cell in cells.values()) else NARROW
    size = (
        LABEL_WIDTH + max(MIN_WIDTH, width * len(columns)) + 0.9,
        HEAD_HEIGHT + ROW_HEIGHT * len(rows) + 0.5,
    )
    with drawn_png(file, size, 110) as figure:
        axes: Axes = figure.subplots()
        for (row, column), cell in cells.items():
            _draw_cell(axes, columns.index(column), rows.index(row), cell)
        _label(axes, rows, columns)
        axes.set_title(title, loc="left", pad=12)
        key = "   ".join(f"{mark} {name}" for name, mark in MARKS.items())
        axes.set_xlabel(key, loc="left", labelpad=8)


def _draw_cell(axes: Axes, x: int, y: int, cell: Cell) -> None:
    fill = FILLS[cell.verdict]
    axes.add_patch(Rectangle((x, y), 1, 1, facecolor=fill, edgecolor="white", linewidth=1.5))
    text = f"{MARKS[cell.verdict]} {cell.text}".strip()
    axes.text(
        x + 0.5, y + 0.5, text, color=INK[cell.verdict], ha="center", va="center", fontsize=10
    )


def _label(axes: Axes, rows: Sequence[str], columns: Sequence[str]) -> None:
    axes.set_xlim(0, len(columns))
    axes.set_ylim(len(rows), 0)
    axes.set_xticks([x + 0.5 for x in range(len(columns))], columns, rotation=60, ha="left")
    axes.set_yticks([y + 0.5 for y in range(len(rows))], rows)
    axes.tick_params(length=0, labeltop=True, labelbottom=False)
    axes.tick_params(axis="x", pad=-1)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def main(results: Path, folder: Path) -> None:
    """Write the page and its pictures to `folder`."""
    write_page(read_results(results), folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m reports.stress_matrix",
        description="Write stress.md and its pictures from the table of `rlbench stress`.",
    )
    parser.add_argument("results", type=Path, nargs="?", default=Path("results/stress"))
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs/results"))
    arguments = parser.parse_args()
    main(arguments.results, arguments.folder)

"""A grid of verdicts as a picture: a row per method, a column per test or section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from reports.layout.style import BLACK, RC

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MARKS", "Cell", "draw_grid"]

MARKS = {"passed": "✓", "degraded": "!", "failed": "✗", "skipped": "–"}  # noqa: RUF001
# a light blue, a medium orange, a dark red: distinct for colour-blind readers and in grey
FILLS = {"passed": "#C5E3F3", "degraded": "#F0A830", "failed": "#9E2A0B", "skipped": "#F2F2F2"}
INK = {"passed": BLACK, "degraded": BLACK, "failed": "#FFFFFF", "skipped": "#777777"}
ROW_HEIGHT, NARROW, WIDE = 0.27, 0.27, 0.95  # inches; a wide column holds a count too
MIN_WIDTH = 4.0  # inches, of all columns: the key below them needs it
LABEL_WIDTH, HEAD_HEIGHT = 2.1, 1.7  # inches, of the names of rows and columns


@dataclass(frozen=True)
class Cell:
    """The verdict of a cell, and a text after its mark."""

    verdict: str
    text: str = ""


def draw_grid(
    cells: Mapping[tuple[str, str], Cell],
    rows: Sequence[str],
    columns: Sequence[str],
    title: str,
    file: Path,
) -> None:
    """Write a PNG with a coloured and marked cell for each (row, column); others stay empty."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width = WIDE if any(cell.text for cell in cells.values()) else NARROW
    size = (
        LABEL_WIDTH + max(MIN_WIDTH, width * len(columns)) + 0.9,
        HEAD_HEIGHT + ROW_HEIGHT * len(rows) + 0.5,
    )
    with mpl.rc_context(RC):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axes: Axes = figure.subplots()
        for (row, column), cell in cells.items():
            _draw_cell(axes, columns.index(column), rows.index(row), cell)
        _label(axes, rows, columns)
        axes.set_title(title, loc="left", pad=12)
        key = "   ".join(f"{mark} {name}" for name, mark in MARKS.items())
        axes.set_xlabel(key, loc="left", labelpad=8)
        file.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(file, dpi=110, metadata={})


def _draw_cell(axes: Axes, x: int, y: int, cell: Cell) -> None:
    from matplotlib.patches import Rectangle

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

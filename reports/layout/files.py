"""Files of reports: figures with their tables; they appear whole or not at all."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure

from reports.layout.style import RC
from rlbench.system.paths import atomic_write

if TYPE_CHECKING:
    import pandas as pd


def write_figure(
    draw: Callable[[], Figure] | None, folder: Path, name: str, table: pd.DataFrame | None = None
) -> list[Path]:
    """Draw in the style of all figures, write `name`.png, .pdf and .svg, and .csv of the table."""
    files: list[Path] = []
    if draw is not None:
        with mpl.rc_context(RC):
            files = save_figure(draw(), folder, name)
    if table is not None:
        files.append(folder / f"{name}.csv")
        with atomic_write(files[-1]) as unfinished:
            table.to_csv(unfinished, index=False)
    return files


def save_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write the figure as PNG at 150 dpi, PDF and SVG; equal figures give equal files."""
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    files = [folder / f"{name}.{suffix}" for suffix in undated]
    for file, metadata in zip(files, undated.values(), strict=True):
        with atomic_write(file) as unfinished:
            figure.savefig(unfinished, dpi=150, metadata=metadata)
    return files


def slug(text: str) -> str:
    """The text as part of a file name.

    >>> slug("NVIDIA H100 (x2)")
    'nvidia-h100-x2'
    """
    return "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())


@contextmanager
def drawn_png(file: Path, size: tuple[float, float], dpi: float = 150) -> Iterator[Figure]:
    """A figure of `size` inches to draw on; at the end it becomes the PNG `file`."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        with atomic_write(file) as unfinished:
            figure.savefig(unfinished, dpi=dpi, metadata={})


def folder_argument(module: str, description: str) -> Path:
    """The folder that a command `python -m reports.MODULE FOLDER` names; default docs/results."""
    parser = argparse.ArgumentParser(prog=f"python -m reports.{module}", description=description)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs/results"))
    folder: Path = parser.parse_args().folder
    return folder

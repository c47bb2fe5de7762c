"""Lint clip folders: read them, run all checks, print a tick list, draw a figure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from rlbench.checks.console import OnResults, print_results
from rlbench.checks.lint.checks import lint_clip
from rlbench.checks.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.checks.lint.figure import draw_figure


def lint_clips(
    folders: Sequence[Path],
    figure: Path | None = None,
    frames: int = 8,
    on_results: OnResults | None = None,
) -> bool:
    """Check clip folders and print the results. Returns False if a check failed.

    `on_results` receives the results and the title of each clip in place of the printing.

    Reads the first `frames` frames of each clip (0: all). `figure` is a PNG to write; with several
    clips, each has its own, with the folder's name appended. Raises ClipError where a folder is not
    a finished clip.
    """
    console, all_passed = Console(quiet=on_results is not None), True
    show = on_results or partial(print_results, console=console)
    for folder in folders:
        arrays = read_clip_arrays(folder, frames)
        results = lint_clip(arrays)
        all_passed &= show(results, title=_title(arrays))
        if figure:
            numbered = figure.with_name(f"{figure.stem}-{folder.name}.png")
            path = draw_figure(arrays, results, numbered if len(folders) > 1 else figure)
            console.print(f"figure: {path}", highlight=False)
    return all_passed


def _title(arrays: ClipArrays) -> str:
    header, read = arrays.header, len(arrays)
    frames = f"{read} of {header.frames}" if read < header.frames else f"{header.frames}"
    return f"{header.name}: {header.width} x {header.height} pixels, {frames} frames"

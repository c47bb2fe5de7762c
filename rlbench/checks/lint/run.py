"""Linting clip folders: read, examine, tell, draw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from rlbench.checks.console import tick_list
from rlbench.checks.finding import Verdict
from rlbench.checks.lint.checks import examine
from rlbench.checks.lint.clip_arrays import read_footage
from rlbench.checks.lint.figure import draw


def lint(folders: Sequence[Path], picture: Path | None = None, frames: int = 8) -> bool:
    """Tell what every check says of each clip folder; has none failed?

    Of each clip the first `frames` frames are read (0: all). `picture` is a PNG to write; of
    several clips each has its own, with the folder's name in it. Raises ClipError where a folder is
    not a finished clip.
    """
    console, sound = Console(), True
    for folder in folders:
        footage = read_footage(folder, frames)
        findings = examine(footage)
        tick_list(footage, findings, console)
        if picture:
            own = picture.with_name(f"{picture.stem}-{folder.name}.png")
            path = draw(footage, findings, own if len(folders) > 1 else picture)
            console.print(f"picture: {path}", highlight=False)
        sound = sound and all(each.verdict is not Verdict.FAIL for each in findings)
    return sound

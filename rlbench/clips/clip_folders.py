"""The clips in a folder that a user names, and what is wrong with one that holds none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from rlbench.clips.header import FILE, ClipError
from rlbench.clips.stored import find_clips

__all__ = ["find_all_clips"]

MAX_FILES = 10_000  # that are looked at, so that the error comes at once
FRAMES = (".exr", ".pfm", ".zip")  # files from which rlbench import makes clips


def find_all_clips(folders: Iterable[Path | str]) -> list[Path]:
    """The clip folders at or directly below each of these folders.

    Raises ClipError for a folder that does not exist, and for one without a clip; the message says
    whether it holds frames to import.
    """
    return [clip for folder in folders for clip in _find(Path(folder))]


def _find(folder: Path) -> list[Path]:
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise ClipError(f"{folder} {what}. Name a folder that holds clips: each has a {FILE}")
    try:
        return find_clips(folder)
    except ClipError as error:
        if deeper := _parents_of_clips(folder):
            raise ClipError(
                f"{folder} holds clips further down. Name the folders that hold them: "
                f"{', '.join(deeper)}"
            ) from error
        if name := next(_frames(folder), ""):
            raise ClipError(
                f"{folder} holds {name} files and no clip. To make clips of them: "
                f"rlbench import {folder} --layout NAME --out FOLDER; to find the layout: "
                f"rlbench lint --guess {folder}"
            ) from error
        raise


def _parents_of_clips(folder: Path) -> list[str]:
    """The folders below that hold clips, sorted."""
    files = islice(folder.rglob("*"), MAX_FILES)
    return sorted({str(file.parents[1]) for file in files if file.name == FILE})


def _frames(folder: Path) -> Iterator[str]:
    files = islice(folder.rglob("*"), MAX_FILES)
    return (file.suffix[1:].upper() for file in files if file.suffix.lower() in FRAMES)

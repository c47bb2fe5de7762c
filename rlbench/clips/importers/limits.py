"""Doors: what may be read of files by strangers, and how much of it at most."""

from __future__ import annotations

import os
from pathlib import Path

from rlbench.clips.importers.sequence import SourceError

MOST_FILES = 1_000_000  # below one source
MOST_PIXELS = 2**26  # of an image: 8192 x 8192
MOST_SAMPLES = 64  # of one frame
MOST_BYTES = 2**31  # of one array, unpacked


def files(root: Path) -> list[Path]:
    """Regular files at and below `root`, sorted. Linked folders are not entered.

    Raises SourceError where there is no folder, a link leads out of it, or there are too many.
    """
    if not root.is_dir():
        raise SourceError(f"no folder {root}; SOURCE is a folder of frames")
    found: list[Path] = []
    for place, folders, names in os.walk(root):
        for folder in folders:
            check_inside(root, Path(place, folder))
        found += [check_inside(root, Path(place, name)) for name in names]
        if len(found) > MOST_FILES:
            raise SourceError(f"{root} holds more than {MOST_FILES} files; name a folder inside it")
    return sorted(path for path in found if path.is_file())


def check_inside(root: Path, path: Path) -> Path:
    """`path`, if it lies below `root` after its links are followed. Raises SourceError."""
    if path.is_symlink() and not path.resolve().is_relative_to(root.resolve()):
        raise SourceError(
            f"{path} is a link that leaves {root}, to {path.resolve()}; it is not followed. "
            "Copy what it names into the source, or remove it"
        )
    return path


def check_size(path: Path, height: int, width: int) -> tuple[int, int]:
    """The size of an image that claims to be so large, if it may be. Raises SourceError."""
    if min(height, width) < 1 or height * width > MOST_PIXELS:
        raise SourceError(
            f"{path} claims to be {width} x {height} pixels; from 1 to {MOST_PIXELS} are read"
        )
    return height, width


def same_size(path: Path, found: tuple[int, int], wanted: tuple[int, int]) -> None:
    """Raise SourceError where an image is not as large as the first of its sequence."""
    if found != wanted:
        raise SourceError(
            f"{path} is {found[1]} x {found[0]} pixels, the first image of its sequence "
            f"{wanted[1]} x {wanted[0]}; all frames of a clip have one size"
        )

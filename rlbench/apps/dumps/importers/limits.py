"""Limits for untrusted files: which files are read, and how much of them at most."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from rlbench.clips.header import MAX_PIXELS
from rlbench.errors import SourceError

MAX_FILES = 1_000_000  # at and below one source folder
MAX_SAMPLES = 64  # per pixel and frame
MAX_ARRAY_BYTES = 2**31  # of one array, unpacked
LARGE_IMAGE_BYTES = 2**29  # of one image, unpacked: 45 megapixels
MAX_PACKING = 500  # times that the images of a clip are smaller on the disk, if they are large


def list_files(root: Path) -> list[Path]:
    """Regular files at and below `root`, sorted. Linked folders are not entered.

    Raises SourceError where `root` is not a folder, a folder in it cannot be read, a link leads
    out of it, or it has too many files.
    """
    return [path for path in list_entries(root) if path.is_file()]


def list_entries(root: Path) -> list[Path]:
    """All that is at and below `root` except real folders, sorted: also links to folders.

    Raises SourceError as `list_files`.
    """
    if not root.is_dir():
        raise SourceError(f"no folder {root}; SOURCE must be a folder of frames")
    entries: list[Path] = []
    for folder, subfolders, names in os.walk(root, onerror=_refuse_folder):
        inside = [check_inside(root, Path(folder, name)) for name in (*subfolders, *names)]
        entries += [path for path in inside if path.is_symlink() or not path.is_dir()]
        if len(entries) > MAX_FILES:
            raise SourceError(f"{root} holds more than {MAX_FILES} files; name a folder inside it")
    return sorted(entries)


def _refuse_folder(error: OSError) -> NoReturn:
    """Raise SourceError: what is in a folder that cannot be read would be lost silently."""
    raise SourceError(
        f"{error.filename} cannot be read ({error.strerror}); make it readable, or move it out of "
        "the source"
    ) from error


def check_inside(root: Path, path: Path) -> Path:
    """`path`, if its links do not lead out of `root`, or to themselves. Raises SourceError."""
    try:
        target = path.resolve() if path.is_symlink() else path
        path.exists()
    except (OSError, RuntimeError) as error:  # Python 3.11 and older raise RuntimeError
        raise SourceError(f"{path} is a link that leads to itself; remove it") from error
    if path.is_symlink() and not target.is_relative_to(root.resolve()):
        raise SourceError(
            f"{path} is a link that leaves {root}, to {path.resolve()}; it is not followed. "
            "Copy its target into the source, or remove the link"
        )
    return path


def check_clip(name: str, files: Sequence[Path], height: int, width: int) -> None:
    """Raise SourceError for frames that are too large for a clip, or of next to no bytes.

    These would fill the memory. Renders of that size, with noise, take a hundred times the bytes.
    """
    pixels = height * width
    if pixels > MAX_PIXELS:
        raise SourceError(
            f"clip '{name}' has frames of {width} x {height}; a clip has up to {MAX_PIXELS} pixels"
        )
    packed = sum(path.stat().st_size for path in files)
    unpacked = len(files) * pixels * 3 * 4
    if pixels * 3 * 4 > LARGE_IMAGE_BYTES and unpacked > MAX_PACKING * packed:
        raise SourceError(
            f"clip '{name}': {len(files)} files of {packed} bytes claim {pixels} pixels each, "
            f"{unpacked} bytes unpacked, so they are nearly constant; import smaller ones"
        )


def check_same_size(path: Path, size: tuple[int, int], expected: tuple[int, int]) -> None:
    """Raise SourceError where an image has another size than the first of its sequence."""
    if size != expected:
        raise SourceError(
            f"{path} is {size[1]} x {size[0]} pixels, the first image of its sequence "
            f"{expected[1]} x {expected[0]}; all frames of a clip must have one size"
        )

"""What the cache folder holds: clips, decoded frames, kernels and times, with size and last use.

All of it can be made again. Files that this module does not know are never removed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rlbench.registry import apps

CLIP_FILES = ("*.exr", "rounds.*.txt", "pool.*.txt", "clip.toml", "scene.txt")
DECODED = re.compile(r"[0-9a-f]{32}-[0-9a-f]{8}")
NEXT_RUN = "the next run"


@dataclass(frozen=True)
class CacheEntry:
    """Files of the cache that belong together."""

    kind: str  # such as `clips`
    name: str  # of the clip, folder or file
    preset: str  # of a clip; empty for everything else
    files: tuple[Path, ...]
    remade_by: str  # what makes the files again

    @property
    def bytes(self) -> int:
        """Size of the files."""
        return sum(stat.st_size for stat in self._stats())

    @property
    def last_used(self) -> float:
        """Seconds since 1970 at which a file was last read or written, as the file system says."""
        return max((max(stat.st_atime, stat.st_mtime) for stat in self._stats()), default=0.0)

    def _stats(self) -> Iterator[os.stat_result]:
        for file in self.files:
            with suppress(FileNotFoundError):  # another process removed it
                yield file.stat()


def find_entries(cache: Path) -> list[CacheEntry]:
    """The known entries of a cache folder, clips first, sorted by name."""
    clips = (folder for folder in sorted(cache.glob("clips/*/*")) if folder.is_dir())
    entries = [
        CacheEntry("clips", clip.name, clip.parent.name, _files(clip, CLIP_FILES), "rlbench render")
        for clip in clips
    ]
    decoded = (f for f in sorted(cache.glob("decoded/*")) if DECODED.fullmatch(f.name))
    entries += [group_files("decoded frames", each, each.rglob("*.npy")) for each in decoded]
    stamps = cache / "decoded" / "stamps"
    entries += [group_files("file hashes", stamps, stamps.glob("*.json"))]
    for find_more in apps.load_parts("cache_entries"):
        entries += find_more(cache)
    entries += [group_files("sample times", cache, _files(cache, ("sample_ms.json",)))]
    return [entry for entry in entries if entry.files]


def group_files(
    kind: str, folder: Path, files: Iterable[Path], remade_by: str = NEXT_RUN
) -> CacheEntry:
    """The entry of files that belong together; it is called after their folder."""
    return CacheEntry(kind, folder.name, "", tuple(sorted(files)), remade_by)


def find_unknown(cache: Path, entries: Iterable[CacheEntry]) -> list[Path]:
    """The files of a cache folder that belong to no entry, sorted; they are never removed."""
    known = {file for entry in entries for file in entry.files}
    return sorted(file for file in cache.rglob("*") if file.is_file() and file not in known)


def remove_entry(entry: CacheEntry, cache: Path) -> None:
    """Remove the files of an entry, and the folders that are then empty.

    Raises OSError where a file cannot be removed.
    """
    for file in entry.files:
        file.unlink(missing_ok=True)
    for folder in sorted({p for f in entry.files for p in f.parents}, key=_depth, reverse=True):
        if folder != cache and folder.is_relative_to(cache):
            with suppress(OSError):  # it holds files that are not known
                folder.rmdir()


def _depth(folder: Path) -> int:
    return len(folder.parts)


def _files(folder: Path, patterns: Iterable[str]) -> tuple[Path, ...]:
    found = (file for pattern in patterns for file in folder.glob(pattern))
    return tuple(sorted(file for file in found if file.is_file()))

"""What a folder of denoised frames holds, and of which sources: NAME.denoise.json beside them.

A frame is finished while its sources and its image are the files that were there when it was
written, by content, whatever their dates are. Files that the record does not know were written by
something else, and are never replaced.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import file_digest, sha256
from pathlib import Path

from rlbench.denoise import DenoiseError
from rlbench.system.documents import decode, read_json
from rlbench.system.store import write_text

__all__ = ["Files", "Record", "Settings", "WrittenFrame", "claim_frames", "read_record"]


@dataclass(frozen=True)
class Files:
    """Some files as they were at one time."""

    stats: tuple[tuple[int, ...], ...]  # size, and what changes when a file is replaced
    digest: str  # of their content

    @classmethod
    def read(cls, paths: Sequence[Path]) -> Files:
        """The files as they are now. Raises OSError for one that is missing."""
        return cls(_read_stats(paths), _hash(paths))

    def are_still(self, paths: Sequence[Path]) -> bool:
        """Whether the files have this content; they are read where anything else changed."""
        if not all(path.is_file() for path in paths):
            return False
        return _read_stats(paths) == self.stats or _hash(paths) == self.digest


def _read_stats(paths: Sequence[Path]) -> tuple[tuple[int, ...], ...]:
    stats = (path.stat() for path in paths)
    return tuple((s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino) for s in stats)


def _hash(paths: Sequence[Path]) -> str:
    digests = []
    for path in paths:
        with path.open("rb") as file:
            digests.append(file_digest(file, "sha256").hexdigest())
    return sha256(" ".join(digests).encode()).hexdigest()[:32]


@dataclass(frozen=True)
class WrittenFrame:
    """The files that a frame was made of, and its images; None before they are written."""

    source: Files | None = None
    images: Files | None = None


@dataclass(frozen=True)
class Settings:
    """What decides the images of a shot, beside its frames."""

    method: str  # and its weights
    exposure: float
    spp: float | str
    static: bool
    also: str  # passes
    first_frame: int | None  # that the memory holds; None without a memory
    layout: str  # hash of the convention of the files


@dataclass
class Record:
    """The settings of a shot, and its frames by their path below the folder."""

    settings: Settings
    frames: dict[str, WrittenFrame] = field(default_factory=dict)

    def write(self, file: Path) -> None:
        """Write the record."""
        write_text(file, json.dumps(dataclasses.asdict(self), indent=1) + "\n")


def read_record(file: Path) -> tuple[Record | None, str]:
    """The record in a file, None without one; a damaged one is set aside, and a note says so."""
    if not file.is_file():
        return None, ""
    try:
        return decode(read_json(file), Record), ""
    except ValueError as error:
        aside = file.with_name(f"{file.name}.damaged")
        file.replace(aside)
        return None, f"damaged, set aside as {aside.name}; frames are denoised again: {error}"


def claim_frames(
    known: Mapping[str, WrittenFrame], outputs: Mapping[str, Sequence[Path]], out: Path
) -> dict[str, WrittenFrame]:
    """The known frames and new ones, whose images are `outputs`.

    Raises DenoiseError for files in their places that are not known, or that changed since.
    """
    foreign, changed = list[Path](), list[Path]()
    for name, paths in outputs.items():
        frame = known.get(name)
        if frame is None:
            foreign += [path for path in paths if path.exists()]
        elif frame.images and all(path.is_file() for path in paths):
            changed += [] if frame.images.are_still(paths) else paths
    for found, what in (
        (foreign, "which this command did not write"),
        (changed, "which changed since it wrote them"),
    ):
        if found:
            listed = ", ".join(str(path.relative_to(out)) for path in found[:4])
            raise DenoiseError(
                f"{out} holds {len(found)} files in the places of denoised frames, {what}: "
                f"{listed}{', ...' * (len(found) > 4)}. Nothing is replaced: give another --out, "
                "or move them"
            )
    return {**known, **{name: known.get(name, WrittenFrame()) for name in outputs}}

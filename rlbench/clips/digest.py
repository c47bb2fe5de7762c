"""The content hash of a clip folder; files that did not change are not read again."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from rlbench.clips.frame_files import exr_path, file_kinds
from rlbench.clips.header import ClipError, Header
from rlbench.system import paths

Stamp = tuple[int, int, str]  # bytes, mtime in ns, sha256 of one file


def clip_digest(folder: Path, header: Header, pool: str) -> str:
    """Hash of what a clip with the samples of `pool` is made of, 32 hex digits.

    That is the files' bytes, without other pools, and the header fields on which pixels depend.

    The time of a sample and the machine that traced it do not count. A file whose size and time
    of change are as remembered is not read again. Raises ClipError where a frame's file is missing.
    """
    remembered = _remembered(folder)
    stamps = {}
    for kind in file_kinds([pool]):
        for index in range(header.frames):
            path = exr_path(folder, kind, index)
            stamps[path.name] = _stamp(path, remembered.get(path.name))
    if (now := remembered | stamps) != remembered:
        with paths.replacing(_memory(folder)) as temporary:
            temporary.write_text(json.dumps(now))
    told = json.dumps([header.pixels(pool), {name: stamp[2] for name, stamp in stamps.items()}])
    return hashlib.sha256(told.encode()).hexdigest()[:32]


def _stamp(path: Path, known: Stamp | None) -> Stamp:
    try:
        stat = path.stat()
        if known is not None and known[:2] == (stat.st_size, stat.st_mtime_ns):
            return known
        with path.open("rb") as file:
            return (stat.st_size, stat.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())
    except FileNotFoundError:
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames") from None


def _memory(folder: Path) -> Path:
    """Where the stamps of a folder are remembered."""
    place = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:32]
    return paths.decoded() / "stamps" / f"{place}.json"


def _remembered(folder: Path) -> dict[str, Stamp]:
    try:
        found = json.loads(_memory(folder).read_text())
        return {name: (int(size), int(time), str(sha)) for name, (size, time, sha) in found.items()}
    except (
        OSError,
        ValueError,
        AttributeError,
        TypeError,
    ):  # a cache: what is unreadable is absent
        return {}

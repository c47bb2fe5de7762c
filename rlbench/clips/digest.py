"""Digest of a clip folder: a content hash. Files that did not change are not read again."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from rlbench.clips.frame_files import exr_path, file_kinds
from rlbench.clips.header import ClipError, Header
from rlbench.system import paths

Stamp = tuple[int, int, str]  # bytes, mtime in ns, sha256 of one file


def clip_digest(folder: Path, header: Header, pool: str) -> str:
    """Hash of the content of a clip with the samples of `pool`, 32 hex digits.

    It covers the bytes of the files, without other pools, and the header fields that decide
    pixels. The time of a sample and the machine that traced it are not covered. A file is read
    again only if its size or modification time changed. Raises ClipError for a missing file.
    """
    cached = _read_stamps(folder)
    stamps = {}
    for kind in file_kinds([pool]):
        for index in range(header.frames):
            path = exr_path(folder, kind, index)
            stamps[path.name] = _stamp(path, cached.get(path.name))
    if (merged := cached | stamps) != cached:
        with paths.cache_write(_stamps_file(folder)) as temporary:
            temporary.write_text(json.dumps(merged))
    hashes = {name: stamp[2] for name, stamp in stamps.items()}
    content = json.dumps([header.digest_fields(pool), hashes])
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def _stamp(path: Path, cached: Stamp | None) -> Stamp:
    try:
        stat = path.stat()
        if cached is not None and cached[:2] == (stat.st_size, stat.st_mtime_ns):
            return cached
        with path.open("rb") as file:
            return (stat.st_size, stat.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())
    except FileNotFoundError:
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames") from None


def _stamps_file(folder: Path) -> Path:
    """The cache file with the stamps of a folder."""
    name = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:32]
    return paths.decoded_folder() / "stamps" / f"{name}.json"


def _read_stamps(folder: Path) -> dict[str, Stamp]:
    """Cached stamps by file name; none where the cache file is absent or unreadable."""
    try:
        stamps = json.loads(_stamps_file(folder).read_text())
        return {
            name: (int(size), int(time), str(sha)) for name, (size, time, sha) in stamps.items()
        }
    except (OSError, ValueError, AttributeError, TypeError):
        return {}

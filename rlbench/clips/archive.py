"""A clip folder as one tar file: equal clips give equal bytes, and nothing is written elsewhere.

EXR files are compressed already, so the archive is not.
"""

from __future__ import annotations

import re
import shutil
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from rlbench.clips.digest import clip_digest
from rlbench.clips.header import FILE, ClipError, Header, read_header
from rlbench.system import paths

__all__ = ["ArchiveError", "clip_digests", "pack_clip", "unpack_clip"]

MEMBER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*\.(exr|toml|txt)")  # a file, in no folder
MAX_MEMBERS = 100_000
CHUNK = 2**20  # bytes copied at once


class ArchiveError(ClipError):
    """An archive that is not one of a clip, or of another clip than it should be."""


def pack_clip(folder: Path, file: Path) -> Header:
    """Write a finished clip to a tar file, which appears whole or not at all; returns its header.

    Members are sorted, and have neither time nor owner. Raises ClipError for an unfinished clip.
    """
    header = read_header(folder)
    members = sorted(path for path in folder.iterdir() if MEMBER.fullmatch(path.name))
    with (
        paths.atomic_write(file) as unfinished,
        tarfile.open(unfinished, "w", format=tarfile.USTAR_FORMAT) as archive,
    ):
        for path in members:
            entry = tarfile.TarInfo(path.name)  # mode 644, time 0, no owner
            entry.size = path.stat().st_size
            with path.open("rb") as stream:
                archive.addfile(entry, stream)
    return header


def unpack_clip(file: Path, folder: Path, digests: Mapping[str, str]) -> Header:
    """Unpack an archive as the clip `folder`, which does not exist yet; returns its header.

    The folder appears only if the clip has the digests that are expected, by pool. Raises
    ArchiveError for a member that is no plain file of a clip, such as `../x`, a link or a folder,
    and for a clip with other content; nothing is left of it then.
    """
    unfinished = folder.with_name(f".{folder.name}.unpacking")
    shutil.rmtree(unfinished, ignore_errors=True)  # that a killed download left
    try:
        unfinished.mkdir(parents=True)
        _extract(file, unfinished)
        header = read_header(unfinished)
        _check_content(file, unfinished, header, digests)
        paths.publish_folder(unfinished, folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return header


def clip_digests(folder: Path) -> dict[str, str]:
    """The digest of a clip with each of its pools, by pool."""
    header = read_header(folder)
    return {pool: clip_digest(folder, header, pool) for pool in header.pools}


def _extract(file: Path, folder: Path) -> None:
    try:
        with tarfile.open(file, "r:") as archive:
            for number, member in enumerate(archive):
                if not (member.isreg() and MEMBER.fullmatch(member.name)):
                    raise ArchiveError(
                        f"{file} has the member {member.name!r}, which is no file of a clip; the "
                        "archive is damaged or malicious, and was not unpacked"
                    )
                stream = archive.extractfile(member)
                if stream is None or number >= MAX_MEMBERS:
                    raise ArchiveError(f"{file} has more than {MAX_MEMBERS} members")
                with paths.atomic_write(folder / member.name) as path, path.open("wb") as out:
                    _copy(stream, out)
    except tarfile.TarError as error:
        raise ArchiveError(f"{file} is no tar file of a clip: {error}") from error


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    while chunk := source.read(CHUNK):
        target.write(chunk)


def _check_content(file: Path, folder: Path, header: Header, digests: Mapping[str, str]) -> None:
    if set(header.pools) != set(digests):
        raise ArchiveError(
            f"{file} has a clip with pools {', '.join(header.pools)}, expected "
            f"{', '.join(digests)}; it was not unpacked"
        )
    for pool, digest in digests.items():
        if (found := clip_digest(folder, header, pool)) != digest:
            raise ArchiveError(
                f"{file} has a clip with digest {found[:12]} ({pool}), expected {digest[:12]}; it "
                f"was not unpacked. {FILE} or a frame is another than the registry states"
            )

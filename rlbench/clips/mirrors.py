"""Registries of clip archives: what there is, by hash, and where it can be downloaded.

A registry is a TOML file with a table `archives` for each archive. That which ships is
`mirrors.toml`; a mirror has its own, `clips.toml`, beside its archives.
"""

from __future__ import annotations

import errno
import hashlib
import shutil
from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from rlbench.clips.header import ClipError
from rlbench.system import documents, paths

__all__ = [
    "INDEX",
    "SHIPPED",
    "ClipArchive",
    "MirrorError",
    "fetch",
    "file_hash",
    "mirror_registry",
    "read_registry",
    "write_registry",
]

SHIPPED = Path(__file__).parent / "mirrors.toml"
INDEX = "clips.toml"  # the registry of a mirror, beside its archives


class MirrorError(ClipError):
    """A registry or a mirror that cannot be used."""


@dataclass(frozen=True)
class ClipArchive:
    """One archive of a clip."""

    preset: str
    clip: str
    file: str  # name on a mirror
    sha256: str  # of the file
    bytes: int  # of the file
    digests: dict[str, str]  # of the clip in it, by pool
    urls: tuple[str, ...] = ()  # where the file is

    def __post_init__(self) -> None:
        """Raise ValueError for names that are paths: they become names of files and folders."""
        for name in (self.preset, self.clip, self.file):
            if not name or name != Path(name).name or name.startswith("."):
                raise ValueError(f"'{name}' is no name of a preset, a clip or a file")


@dataclass(frozen=True)
class _Registry:
    archives: tuple[ClipArchive, ...] = ()


def read_registry(file: Path) -> tuple[ClipArchive, ...]:
    """The archives of a registry. Raises MirrorError for a file that is none."""
    try:
        return documents.decode(documents.read_toml(file), _Registry).archives
    except OSError as error:
        raise MirrorError(f"no registry {file}: {error.strerror}") from error
    except ValueError as error:
        raise MirrorError(f"{file} is no registry of clips: {error}") from error


def write_registry(file: Path, archives: Collection[ClipArchive]) -> None:
    """Write a registry, sorted by preset and clip."""
    ordered = sorted(archives, key=lambda each: (each.preset, each.clip))
    documents.write_toml(file, {"archives": [asdict(each) for each in ordered]})


def mirror_registry(mirror: str, folder: Path) -> tuple[ClipArchive, ...]:
    """The archives of a mirror, an address or a folder, with their addresses on it.

    Its registry is downloaded to `folder`. Raises MirrorError.
    """
    base = Path(mirror).resolve().as_uri() if "://" not in mirror else mirror.rstrip("/")
    index = _retrieve(f"{base}/{INDEX}", None, folder / INDEX)
    return tuple(replace(each, urls=(f"{base}/{each.file}",)) for each in read_registry(index))


def fetch(archive: ClipArchive, folder: Path, progress: Any = False) -> Path:
    """Download an archive to `folder` from the first of its addresses that has it.

    `progress` is an object of pooch's progress bars. Raises MirrorError where no address has a file
    with the archive's hash.
    """
    reasons = []
    for url in archive.urls:
        try:
            return _retrieve(url, f"sha256:{archive.sha256}", folder / archive.file, progress)
        except MirrorError as error:
            reasons.append(str(error))
    raise MirrorError("; ".join(reasons) or f"no mirror has {archive.file}")


def file_hash(file: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _retrieve(url: str, known_hash: str | None, file: Path, progress: Any = False) -> Path:
    """Download by pooch, which checks the hash before the file has its name."""
    try:
        import pooch
    except ImportError as error:
        raise MirrorError("downloads need pooch: pip install 'rlbench[download]'") from error
    pooch.get_logger().setLevel("ERROR")
    file.parent.mkdir(parents=True, exist_ok=True)
    is_local = urlsplit(url).scheme == "file"
    downloader = (
        _copy_local if is_local else pooch.HTTPDownloader(progressbar=progress, chunk_size=2**16)
    )
    try:
        pooch.retrieve(url, known_hash, file.name, file.parent, downloader=downloader)
    except (OSError, ValueError) as error:  # requests raises OSError, pooch ValueError for a hash
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise paths.write_error(file, error) from error
        raise MirrorError(f"{url} cannot be downloaded: {_first_line(error)}") from error
    return file


def _copy_local(url: str, output_file: Any, pooch: Any, check_only: bool = False) -> None:
    """A downloader of pooch for addresses file:///..."""
    with (
        Path(unquote(urlsplit(url).path)).open("rb") as source,
        Path(output_file).open("wb") as target,
    ):
        shutil.copyfileobj(source, target)


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0][:300]

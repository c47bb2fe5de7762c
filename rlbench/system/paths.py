"""The cache folders, writing files atomically, and whether a folder takes files at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import socket
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from rlbench.errors import RlbenchError

UNWRITABLE = {  # errors of the disk or the folder, which the user can mend; numpy gives no number
    None,
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.ENOTDIR, errno.EEXIST, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP),
    *(errno.ESTALE, errno.ENOTCONN, errno.ENODEV, errno.ENXIO),  # a share that went away
}
TEMPORARY = re.compile(r"\.([0-9a-f]{8})([0-9a-f]{8})[0-9a-f]{16}\..+")  # machine and process
ABANDONED_S = 86400.0  # age of a temporary file of another machine that nobody writes any more
PROBE_BYTES = 4096  # written and removed: a full disk may still create empty files


def cache_folder() -> Path:
    """The cache folder: the variable RLBENCH_CACHE, else the user cache of the platform."""
    if folder := os.environ.get("RLBENCH_CACHE"):
        return Path(folder).expanduser()
    from platformdirs import user_cache_path

    return user_cache_path("rlbench", appauthor=False)


def clips_folder() -> Path:
    """The folder of rendered clips, one folder each."""
    return cache_folder() / "clips"


def decoded_folder() -> Path:
    """The folder of decoded copies of clips; it may be deleted at any time."""
    return cache_folder() / "decoded"


def scenes_folder() -> Path:
    """The folder of downloaded scenes by others, one folder each, and of pins that users made."""
    return cache_folder() / "scenes"


class WriteError(RlbenchError, OSError):
    """A file that cannot be written: the disk is full, or the folder is read-only or no folder."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`, then rename it to `path`.

    Readers never see a partial file, not even after a power failure: the content reaches the disk
    before the name does. The folder is created. If the block raises, the temporary file is removed
    and `path` stays as it was. Raises WriteError where the disk or the folder takes no file.
    """
    with _written_aside(path) as temporary:
        yield temporary
        _synchronize(temporary)
    with _explained(path):
        _synchronize(path.parent)


@contextmanager
def cache_write(path: Path) -> Iterator[Path]:
    """`atomic_write` without waiting for the disk, for files that are verified when they are read.

    After a power failure, the file may be damaged.
    """
    with _written_aside(path) as temporary:
        yield temporary


def publish_folder(unfinished: Path, folder: Path) -> None:
    """Give a finished folder its name, at which there is none; the name reaches the disk.

    The files in it must have been written by `atomic_write`, so that they are on the disk already.
    Raises WriteError where the disk or the folder takes no file.
    """
    with _explained(folder):
        unfinished.rename(folder)
        _synchronize(folder.parent)


def open_to_append(path: Path) -> BinaryIO:
    """A file to append to, which is created, as is its folder; never one elsewhere, by a link.

    Raises WriteError for a link, for another irregular file, and where the folder takes no file.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    with _explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        check_no_link(path.parent, path)
        file = os.fdopen(os.open(path, flags, 0o666), "ab", buffering=0)
    status = os.fstat(file.fileno())
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        file.close()
        raise write_error(path, "it is a device, a pipe or a second name of another file")
    return file


def check_no_link(root: Path, path: Path) -> Path:
    """`path`, a file or folder in `root`. Raises WriteError where a part below `root` is a link.

    Results may come from strangers: what is written into their folder must stay in it.
    """
    for part in (path, *path.parents):
        if part == root:
            break
        if part.is_symlink():
            raise WriteError(
                f"{part} is a link, to {os.readlink(part)}, and nothing is written through one; "
                "remove it, or choose another folder"
            )
    return path


def remove_temporaries(folder: Path) -> None:
    """Remove the unfinished files that killed processes left in a folder and below it.

    Those of living processes stay, and so do those of other machines for a day.
    """
    for parent, _, names in os.walk(folder):
        for path in (Path(parent, name) for name in names if TEMPORARY.fullmatch(name)):
            with suppress(OSError):
                if _is_abandoned(path):
                    path.unlink()


def _is_abandoned(temporary: Path) -> bool:
    found = TEMPORARY.fullmatch(temporary.name)
    assert found
    if int(found[1], 16) != _machine_hash():
        with tempfile.TemporaryFile(dir=temporary.parent) as now:  # by the clock of the disk
            age = os.fstat(now.fileno()).st_mtime - temporary.lstat().st_mtime
        return age > ABANDONED_S
    try:
        os.kill(int(found[2], 16), 0)
    except ProcessLookupError:
        return True
    except OSError:  # of another user
        return False
    return False


def _machine_hash() -> int:
    return zlib.crc32(socket.gethostname().encode())


@contextmanager
def _written_aside(path: Path) -> Iterator[Path]:
    """Yield a temporary path and rename it to `path`; nothing is left of it after an error."""
    owner = f"{_machine_hash():08x}{os.getpid():08x}{secrets.token_hex(8)}"
    temporary = path.with_name(f".{owner}.{path.name[-200:]}")
    try:
        with _explained(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Raise errors of the disk and the folder as WriteError."""
    try:
        yield
    except OSError as error:
        has_vanished = error.errno == errno.ENOENT and not path.parent.is_dir()
        if isinstance(error, RlbenchError) or not (has_vanished or error.errno in UNWRITABLE):
            raise
        if has_vanished:
            error = FileNotFoundError(f"its folder {path.parent} was removed meanwhile")
        raise write_error(path, error) from error


def write_error(path: Path, reason: object) -> WriteError:
    """The error for a file that cannot be written: its folder, the free space, and what to do."""
    folder = next(parent for parent in path.absolute().parents if parent.is_dir())
    free = shutil.disk_usage(folder).free
    remedy = "free some space, or choose another folder"
    if not os.access(folder, os.W_OK | os.X_OK):
        remedy = "the folder is not writable: change its permissions, or choose another"
    return WriteError(
        f"{path} cannot be written ({reason}); {folder} has {free} bytes free, {remedy}"
    )


def _synchronize(path: Path) -> None:
    """Wait until a file or the entries of a folder are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems sync no folder
            raise
    finally:
        os.close(descriptor)


class FolderNotWritableError(WriteError):
    """A folder that takes no file, found out before anything was computed."""


def check_writable(folder: Path, setting: str = "--out") -> None:
    """Raise FolderNotWritableError unless files can be written in `folder`.

    A folder that does not exist is not created; the one above it is tried. Nothing is left in it.
    `setting` is what names another folder.
    """
    absolute = folder.absolute()
    existing = next(path for path in (absolute, *absolute.parents) if os.path.lexists(path))
    try:
        with tempfile.TemporaryFile(dir=existing) as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
    except OSError as error:
        free = f"{_free_bytes(existing)} bytes free"
        raise FolderNotWritableError(
            f"nothing can be written to {folder} ({error.strerror}; {existing} has {free}). "
            f"Free some space, or name another folder by {_describe(setting)}"
        ) from error


def write_remedy(error: WriteError) -> str:
    """What names another folder than the one in the message of `error`; what is done is kept."""
    is_in_cache = str(cache_folder()) in str(error)
    return f"{_describe('RLBENCH_CACHE' if is_in_cache else '--out')} names another folder"


def _describe(setting: str) -> str:
    return "the variable RLBENCH_CACHE" if setting == "RLBENCH_CACHE" else setting


def _free_bytes(path: Path) -> int:
    folder = path if path.is_dir() else path.parent
    return shutil.disk_usage(folder).free

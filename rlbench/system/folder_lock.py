"""One writer a folder: a second command that would write to a results folder is refused.

The lock is `flock` on a file in the folder. The kernel releases it when its owner ends, also after
kill -9, so no lock is ever left behind. On NFS it holds between machines where the server supports
locks (Linux translates it to a byte-range lock); a file system without locks is used unlocked.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rlbench.errors import RlbenchError
from rlbench.system.paths import write_error

__all__ = ["LOCK_FILE", "FolderInUseError", "locked_folder"]

LOCK_FILE = ".rlbench-lock"
UNSUPPORTED = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # the file system has no locks


class FolderInUseError(RlbenchError, OSError):
    """A folder that another process writes to."""


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the only lock of a folder, which is created.

    Raises FolderInUseError at once while another process holds it, and WriteError where the lock
    file cannot be written. The lock file is removed at the end.
    """
    file = folder / LOCK_FILE
    descriptor = _acquire(folder, file)
    try:
        yield
    finally:
        with suppress(OSError):
            file.unlink()  # while the lock is held: whoever waits opens a new file
        os.close(descriptor)


def _acquire(folder: Path, file: Path) -> int:
    """A descriptor that holds the lock."""
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise write_error(file, error) from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in UNSUPPORTED:
                owner = os.pread(descriptor, 200, 0).decode(errors="replace")
                os.close(descriptor)
                raise FolderInUseError(_describe(folder, owner)) from error
        if _is_current(descriptor, file):
            with suppress(OSError):  # a full disk: the lock holds without the name of its owner
                os.ftruncate(descriptor, 0)
                os.pwrite(
                    descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0
                )
            return descriptor
        os.close(descriptor)  # its owner removed the file after it was opened here


def _is_current(descriptor: int, file: Path) -> bool:
    """Is the locked file still the one in the folder?"""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False


def _describe(folder: Path, owner: str) -> str:
    who = f" ({owner})" if owner else ""
    return (
        f"another rlbench{who} writes to {folder}. Wait until it ends and repeat the command, "
        "which continues from its results; or choose another folder with --out"
    )

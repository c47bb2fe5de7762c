"""One writer a folder: a second command that would write to a results folder is refused.

The kernel releases the lock when its owner ends, also after kill -9, so no lock is ever left
behind. On NFS it holds between machines where the server supports locks; a file system without
locks is used unlocked.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from rlbench.errors import RlbenchError
from rlbench.system.paths import remove_temporaries, write_error

LOCK_FILE = ".rlbench-lock"
UNSUPPORTED = (errno.ENOLCK, errno.ENOTSUP)  # the file system has no locks


class FolderInUseError(RlbenchError, OSError):
    """A folder that another process writes to."""


@contextmanager
def locked_folder(folder: Path, part: str = "") -> Iterator[None]:
    """Hold the only lock of a folder, which is created; or that of one `part` of its content.

    Raises FolderInUseError at once while another process holds it, and WriteError where the lock
    file cannot be written. The lock file is removed at the end.
    """
    file = folder / f"{LOCK_FILE}{part}"
    lock = FileLock(file, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        owner = file.read_text(errors="replace") if file.is_file() else ""
        raise FolderInUseError(
            f"another rlbench{f' ({owner})' if owner else ''} writes to {folder}. Wait until it "
            "ends and repeat the command, which continues from its results; or choose another "
            "folder with --out"
        ) from error
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise write_error(file, error) from error
    try:
        with suppress(OSError):  # a full disk: the lock holds without the name of its owner
            file.write_text(f"process {os.getpid()} on {socket.gethostname()}")
        remove_temporaries(folder)
        yield
    finally:
        with suppress(OSError):
            file.unlink()  # while the lock is held: whoever waits opens a new file
        lock.release()

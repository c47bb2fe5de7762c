"""Whether a folder takes files, found out before long work, and what to say where it does not."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from rlbench.system import paths
from rlbench.system.paths import WriteError

__all__ = ["FolderNotWritableError", "check_writable", "write_remedy"]

PROBE_BYTES = 4096  # written and removed: a full disk may still create empty files


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
    is_in_cache = str(paths.cache_folder()) in str(error)
    return f"{_describe('RLBENCH_CACHE' if is_in_cache else '--out')} names another folder"


def _describe(setting: str) -> str:
    return "the variable RLBENCH_CACHE" if setting == "RLBENCH_CACHE" else setting


def _free_bytes(path: Path) -> int:
    folder = path if path.is_dir() else path.parent
    return shutil.disk_usage(folder).free

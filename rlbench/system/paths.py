"""The cache folders, and writing files atomically."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["cache_folder", "clips_folder", "decoded_folder", "atomic_write"]


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


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`, then rename it to `path`.

    Readers never see a partial file. The folder is created. If the block raises, the temporary file
    is removed and `path` stays as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid.uuid4().hex}.{path.name}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)

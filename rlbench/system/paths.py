"""Where files lie: the cache and its folders, and how a file comes to be whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def cache() -> Path:
    """The cache folder: the variable RLBENCH_CACHE, else the platform's user cache."""
    if chosen := os.environ.get("RLBENCH_CACHE"):
        return Path(chosen).expanduser()
    from platformdirs import user_cache_path

    return user_cache_path("rlbench", appauthor=False)


def clips() -> Path:
    """Where rendered clips are kept, one folder each."""
    return cache() / "clips"


def decoded() -> Path:
    """Where decoded copies of clips are kept; may be deleted at any time."""
    return cache() / "decoded"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it at the end: readers never see half a file.

    The folder is made. If the block raises, nothing of the new file is left.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid.uuid4().hex}.{path.name}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)

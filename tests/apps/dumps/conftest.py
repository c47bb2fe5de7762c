"""Clips of the tests of dumps, made once: in memory, on disk, and as a source."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from tests.apps.dumps.importers.sources import write_oidn
from tests.apps.dumps.lint.broken_fixtures import correct_clip, store


@pytest.fixture(scope="session")
def arrays() -> ClipArrays:
    return correct_clip()


@pytest.fixture(scope="session")
def short() -> ClipArrays:
    """Three frames."""
    return correct_clip(frames=3)


@pytest.fixture(scope="session")
def folder(arrays, tmp_path_factory) -> Path:
    return store(arrays, tmp_path_factory.mktemp("lint") / "correct")


@pytest.fixture
def source(tmp_path) -> Path:
    """A folder of OIDN's training images: clip `walk`, 3 frames, 2 samples per pixel."""
    return write_oidn(tmp_path / "source")

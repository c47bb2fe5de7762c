"""A correct clip in memory and on disk, shared by the tests of lint."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from tests.apps.dumps.lint.broken_fixtures import correct_clip, store


@pytest.fixture(scope="session")
def arrays() -> ClipArrays:
    return correct_clip()


@pytest.fixture(scope="session")
def folder(arrays, tmp_path_factory) -> Path:
    return store(arrays, tmp_path_factory.mktemp("lint") / "correct")

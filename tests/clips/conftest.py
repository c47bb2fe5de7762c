"""A clip folder for the tests of clips."""

from __future__ import annotations

import pytest

from tests.clips.clip_folders import write_clip


@pytest.fixture
def folder(tmp_path):
    """A finished clip of 2 frames, in a folder with no other clip."""
    return write_clip(tmp_path / "clips" / "street")

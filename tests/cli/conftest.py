"""Fixtures of the command line's tests."""

from __future__ import annotations

import pytest


@pytest.fixture
def run_mean(clip_folder, tmp_path):
    """The command that runs `mean` on one small clip."""
    return ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")

"""Fixtures of the command line's tests."""

from __future__ import annotations

import logging
import shutil
import signal
import subprocess

import pytest


@pytest.fixture(autouse=True)
def _own_logger():
    """Commands set the level of the logger `rlbench`; other tests find it as it was."""
    yield
    logger = logging.getLogger("rlbench")
    logger.handlers, logger.propagate = [], True
    logger.setLevel(logging.NOTSET)


@pytest.fixture
def interrupts():
    """Ctrl-C raises KeyboardInterrupt, as in a foreground job; background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 KiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(words, check=False).returncode:
        pytest.skip("no file system can be mounted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)  # lazily: files may be open


@pytest.fixture
def run_mean(clip_folder, tmp_path):
    """The command that runs `mean` on one small clip."""
    return ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")

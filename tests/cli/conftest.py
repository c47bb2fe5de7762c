"""Fixtures of the command line's tests."""

from __future__ import annotations

import logging
import shutil
import signal
import subprocess

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_noise


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


@pytest.fixture(scope="session")
def image_run(tmp_path_factory):
    """A clip and results with images, without times: mean and eaw at 1 and 2 spp."""
    root = tmp_path_factory.mktemp("images")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(root / "cache"))
        words = ("run", "-m", "mean,eaw", "--clips", write_noise(root / "clips" / "noise"))
        words += ("--spp", "1,2", "--times", "none", "--keep-images", "--out", root / "r")
        rlbench(*words)
    return root


@pytest.fixture
def image_results(image_run, tmp_path):
    """A copy of the results of `image_run`, which a test may change."""
    return shutil.copytree(image_run / "r", tmp_path / "r")


@pytest.fixture
def plain_results(image_results):
    """A copy of these results without images."""
    shutil.rmtree(image_results / "images")
    return image_results


@pytest.fixture
def run_mean(clip_folder, tmp_path):
    """The command that runs `mean` on one small clip."""
    return ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")

"""A Ray cluster loses a machine, or its head, while jobs run: one line says what happens now."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec

import pytest

from tests.cli.runner import CHECKOUT, ENVIRONMENT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not find_spec("ray"), reason='pip install "rlbench[ray]"'),
]


def run_losing(part, folder):
    """The lines of standard output and of standard error, without those of Ray's start."""
    words = [sys.executable, "-m", "tests.apps.cluster.losing_run", part, str(folder)]
    process = subprocess.run(
        words, cwd=CHECKOUT, env=ENVIRONMENT, capture_output=True, text=True, timeout=200
    )
    assert process.returncode == 0, process.stderr
    errors = [line for line in process.stderr.splitlines() if "ray address" not in line.lower()]
    return process.stdout.splitlines(), errors


def test_a_lost_machine_is_one_line_and_its_jobs_run_on_the_other(tmp_path):
    values, (line,) = run_losing("machine", tmp_path)
    assert values == ["[0, 10, 20, 30, 40, 50]"]
    assert "with 1 processors; finished jobs are kept" in line
    assert "run again on the 1 that are left" in line


@pytest.mark.parametrize("part", ["gcs_server", "raylet"])
def test_a_lost_cluster_is_one_line_that_says_what_is_kept(tmp_path, part):
    (line,), _ = run_losing(part, tmp_path)
    finished, left = map(int, re.findall(r"(\d) of 6 jobs are finished and kept, (\d)", line)[0])
    assert finished + left == 6
    assert finished >= 1

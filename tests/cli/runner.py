"""Runs commands of the command line, in this process or in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from rlbench.cli.app import app

CHECKOUT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


def rlbench(*words: object, code: int = 0) -> str:
    """The output of a command, errors included, in one line; checks its exit code."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def python(*words: str) -> str:
    """The output of a Python process."""
    process = subprocess.run(
        [sys.executable, *words], cwd=CHECKOUT, env=ENVIRONMENT, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    return process.stdout

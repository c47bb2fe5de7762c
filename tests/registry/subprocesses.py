"""Runs a program in a fresh Python process, which has imported nothing."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_python(program: str) -> str:
    """Standard output of an indented program, run in the repository."""
    command = [sys.executable, "-c", textwrap.dedent(program)]
    process = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return process.stdout

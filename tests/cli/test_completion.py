"""The shell completes commands, options and names, and imports nothing heavy for it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.cli.runner import CHECKOUT, ENVIRONMENT
from tests.cli.test_app import RUN


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("rlbench eva", "evaluate"),
        ("rlbench check our", "ours"),
        ("rlbench run -m mean,oidn/tu", "mean,oidn/tuned"),
        ("rlbench render --preset min", "mini"),
        ("rlbench run --scenes tem", "temple"),
        ("rlbench report paret", "pareto"),
    ],
)
def test_names_are_completed_without_importing_torch(line, expected):
    words = line.split()
    environment = {
        **ENVIRONMENT,
        "_RLBENCH_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    program = RUN.replace("app()", "app(prog_name='rlbench')")
    process = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=CHECKOUT,
        env=environment,
        check=False,
    )
    assert expected in process.stdout.split()
    assert process.stderr.splitlines()[-1] == "imported:"

"""Threads that wait for each other sleep when asked to; the OpenMP library itself says so."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCRIPT = """
import sys
from rlbench.system.process_settings import wait_asleep
assert "torch" not in sys.modules
wait_asleep()
import torch
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems bring another OpenMP")
@pytest.mark.parametrize(("chosen", "expected"), [(None, "PASSIVE"), ("active", "ACTIVE")])
def test_torchs_threads_sleep_while_they_wait_unless_the_user_chose(chosen, expected):
    environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    environment |= {"OMP_DISPLAY_ENV": "true"} | ({"OMP_WAIT_POLICY": chosen} if chosen else {})
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    assert f"OMP_WAIT_POLICY = '{expected}'" in done.stderr

"""How the threads of torch wait for each other on a busy machine."""

from __future__ import annotations

import os

__all__ = ["wait_asleep"]


def wait_asleep() -> None:
    """Let threads that wait sleep, where they would spin. Call this before torch is imported.

    Torch's OpenMP threads spin between parallel loops. On an idle machine that saves some
    microseconds a loop; beside other processes a waiting thread takes the processor from the one
    that it waits for, and a run takes several times as long. A policy that the user has set in
    the environment variable OMP_WAIT_POLICY stays.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")

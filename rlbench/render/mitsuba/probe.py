"""Trying a library in a process of its own, once: what cannot be used may end the process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rlbench.system import paths


def probe_subprocess(code: str, setting: dict[str, str]) -> str:
    """Why `code`, which prints `usable` at the end, fails with these variables; empty if it works.

    It has an empty kernel cache, since kernels that another library has compiled would hide faults.
    """
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "DRJIT_CACHE_DIR": empty, **setting}
        run = [sys.executable, "-c", code]
        try:
            done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=120)
        except subprocess.TimeoutExpired:
            return "did not finish within 120 s"
    if done.returncode == 0 and done.stdout.startswith("usable"):
        return ""
    if done.returncode < 0:
        return f"ended by signal {-done.returncode} (too old, or of another kind)"
    words = [line for line in done.stderr.splitlines() if line.strip()]
    return words[-1].strip()[:200] if words else f"exit code {done.returncode}"


def file_stamp(path: Path) -> str:
    """A library as it is now: another one in its place has another stamp."""
    return f"{path} {path.stat().st_mtime_ns if path.exists() else 0}"


def read_result(note: Path, key: str) -> str | None:
    """The reason that is noted in a file, or None where there is none for this key."""
    known: dict[str, str] = json.loads(note.read_text()) if note.exists() else {}
    return known.get(key)


def store_result(note: Path, key: str, reason: str) -> str:
    """Note a reason in a file, and return it."""
    known: dict[str, str] = json.loads(note.read_text()) if note.exists() else {}
    with paths.replacing(note) as file:
        file.write_text(json.dumps({**known, key: reason}, indent=1))
    return reason

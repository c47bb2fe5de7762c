"""Tries a library in a subprocess, because an unusable one may abort the process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rlbench.system import paths

__all__ = ["file_stamp", "probe_subprocess", "read_result", "store_result"]

TIMEOUT_S = 120


def probe_subprocess(code: str, variables: dict[str, str]) -> str:
    """Why `code` fails with these environment variables; empty if it prints `usable`.

    The kernel cache is empty, since kernels that another library compiled would hide faults.
    """
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "DRJIT_CACHE_DIR": empty, **variables}
        command = [sys.executable, "-c", code]
        try:
            process = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S
            )
        except subprocess.TimeoutExpired:
            return f"did not finish within {TIMEOUT_S} s"
    if process.returncode == 0 and process.stdout.startswith("usable"):
        return ""
    if process.returncode < 0:
        return f"ended by signal {-process.returncode} (too old or incompatible)"
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    return lines[-1].strip()[:200] if lines else f"exit code {process.returncode}"


def file_stamp(path: Path) -> str:
    """Path and modification time of a library; changes if the file is replaced."""
    return f"{path} {path.stat().st_mtime_ns if path.exists() else 0}"


def read_result(cache: Path, key: str) -> str | None:
    """The cached result of a probe, or None if there is none for this key."""
    results: dict[str, str] = json.loads(cache.read_text()) if cache.exists() else {}
    return results.get(key)


def store_result(cache: Path, key: str, reason: str) -> str:
    """Add the result of a probe to the cache file, and return it."""
    results: dict[str, str] = json.loads(cache.read_text()) if cache.exists() else {}
    with paths.atomic_write(cache) as file:
        file.write_text(json.dumps({**results, key: reason}, indent=1))
    return reason

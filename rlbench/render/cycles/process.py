"""Runs the Cycles worker in Blender's process: its Python, its events, and how it ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rlbench.errors import RlbenchError

__all__ = [
    "INSTALL_HINT",
    "PYTHON_VARIABLE",
    "TESTED_BPY_VERSION",
    "CyclesError",
    "bpy_version",
    "interpreter",
]

PYTHON_VARIABLE = "RLBENCH_CYCLES_PYTHON"  # the Python that has bpy; default this one
WORKER = Path(__file__).parent / "worker" / "worker.py"
TESTED_BPY_VERSION = "4.5.15"  # of bpy, for which settings and passes were measured
LOG_TAIL_LINES = 12  # of Blender's log, in error messages
INSTALL_HINT = (
    f"pip install 'rlbench[cycles]' into a Python 3.11, or `python3.11 -m venv cycles && "
    f"cycles/bin/pip install bpy=={TESTED_BPY_VERSION}` and {PYTHON_VARIABLE}=cycles/bin/python"
)


class CyclesError(RlbenchError, RuntimeError):
    """Blender is missing, rejected the scene, or its process failed."""


def interpreter() -> str:
    """The Python that runs the worker."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def bpy_version() -> str | None:
    """The version of bpy in the worker's Python, or None. bpy is not imported."""
    code = "import importlib.metadata as m; print(m.version('bpy'))"
    try:
        process = subprocess.run(
            [interpreter(), "-I", "-c", code], capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return process.stdout.strip() or None if process.returncode == 0 else None


def run_worker(job: Mapping[str, Any], log: Path) -> Iterator[dict[str, Any]]:
    """The events of a job (see worker/README.md) as they arrive, until it is done.

    Blender's output goes to `log`, the job to a JSON file beside it. Closing the iterator ends the
    process. Raises CyclesError if bpy is missing, if the worker rejects the job, and if its process
    dies; the message has the last lines of the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    job_file = log.with_suffix(".json")
    job_file.write_text(json.dumps(job))
    command = [interpreter(), "-I", str(WORKER), str(job_file)]
    try:
        with log.open("wb") as stderr:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=stderr
            )
    except OSError as error:
        raise CyclesError(f"{PYTHON_VARIABLE}: {command[0]} cannot be run: {error}") from error
    is_done = False
    with process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                event = _parse_event(line)
                if event.get("event") == "error":
                    process.wait()
                    raise CyclesError(_rejection_message(event, log))
                is_done = is_done or event.get("event") == "done"
                yield event
            process.wait()
        finally:
            process.kill()
    if not is_done or process.returncode:
        raise CyclesError(_exit_message(process.returncode, log))


def _parse_event(line: bytes) -> dict[str, Any]:
    """One event; empty for anything else, such as half a line from a process that died."""
    try:
        event = json.loads(line)
    except ValueError:
        return {}
    return event if isinstance(event, dict) else {}


def _rejection_message(event: Mapping[str, Any], log: Path) -> str:
    message = event.get("message", "")
    if event.get("kind") == "missing":
        return f"Cycles needs bpy, which {interpreter()} does not have ({message}): {INSTALL_HINT}"
    if event.get("kind") == "job":
        return f"Blender: {message}"
    return f"the Cycles worker failed: {message}{_log_tail(log)}"


def _exit_message(code: int, log: Path) -> str:
    """Why the process ended too early, as far as its exit code tells."""
    if code >= 0:
        return f"Blender's process ended with exit code {code} before it was done{_log_tail(log)}"
    name = signal.Signals(-code).name
    reason = {
        "SIGKILL": "it was killed, by a user or because the machine ran out of memory",
        "SIGSEGV": "it crashed (segmentation fault)",
        "SIGABRT": "it aborted, often because it ran out of memory",
    }.get(name, "it was stopped")
    hint = "finished images are kept; the same command resumes"
    return f"Blender's process ended by {name}: {reason}; {hint}{_log_tail(log)}"


def _log_tail(log: Path) -> str:
    lines = log.read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:] if log.is_file() else []
    text = "".join(f"\n  {line}" for line in lines)
    return f". The end of {log}:{text}" if lines else f". It wrote nothing to {log}"

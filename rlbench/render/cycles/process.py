"""Blender's process: which Python runs it, its events as they come, and how it ended."""

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

PYTHON_VARIABLE = "RLBENCH_CYCLES_PYTHON"  # the Python that has bpy; default this one
WORKER = Path(__file__).parent / "worker" / "worker.py"
VERSION = "4.5.15"  # of bpy, on which the settings and passes were measured
LOG_TAIL_LINES = 12  # lines of Blender's log that an error tells
INSTALL = (
    f"pip install 'rlbench[cycles]' into a Python 3.11, or `python3.11 -m venv cycles && "
    f"cycles/bin/pip install bpy=={VERSION}` and {PYTHON_VARIABLE}=cycles/bin/python"
)


class CyclesError(RlbenchError, RuntimeError):
    """Blender is missing, refused the scene, or its process broke down."""


def interpreter() -> str:
    """The Python that runs the worker."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def installed() -> str | None:
    """The version of bpy that the worker's Python has, or None; nothing of it is imported."""
    asked = "import importlib.metadata as m; print(m.version('bpy'))"
    try:
        found = subprocess.run(
            [interpreter(), "-I", "-c", asked], capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return found.stdout.strip() or None if found.returncode == 0 else None


def run_worker(job: Mapping[str, Any], log: Path) -> Iterator[dict[str, Any]]:
    """Events of a job (see worker/README.md) as they come, until it is done.

    Blender's own words go to `log`, the job into a file beside it. If the caller stops listening,
    the process ends. Raises CyclesError if bpy is missing, if the worker refuses the job, and if
    its process dies, with the last lines of the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    order = log.with_suffix(".json")
    order.write_text(json.dumps(job))
    command = [interpreter(), "-I", str(WORKER), str(order)]
    try:
        with log.open("wb") as words:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=words
            )
    except OSError as error:
        raise CyclesError(f"{PYTHON_VARIABLE}: {command[0]} cannot be run: {error}") from error
    done = False
    with process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                event = _event(line)
                if event.get("event") == "error":
                    process.wait()
                    raise CyclesError(_refused(event, log))
                done = done or event.get("event") == "done"
                yield event
            process.wait()
        finally:
            process.kill()
    if not done or process.returncode:
        raise CyclesError(_died(process.returncode, log))


def _event(line: bytes) -> dict[str, Any]:
    """One event; what is none, as half a line of a process that died, is an empty one."""
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _refused(event: Mapping[str, Any], log: Path) -> str:
    message = event.get("message", "")
    if event.get("kind") == "missing":
        return f"Cycles needs bpy, which {interpreter()} does not have ({message}): {INSTALL}"
    if event.get("kind") == "job":
        return f"Blender: {message}"
    return f"the Cycles worker failed: {message}{_tail(log)}"


def _died(code: int, log: Path) -> str:
    """What a process that ended before it was done died of, as far as its exit code says."""
    if code >= 0:
        return f"Blender's process ended with exit code {code} before it was done{_tail(log)}"
    name = signal.Signals(-code).name
    why = {
        "SIGKILL": "it was killed; where nobody did so, the machine ran out of memory",
        "SIGSEGV": "it crashed (segmentation fault)",
        "SIGABRT": "it aborted; often it ran out of memory",
    }.get(name, "it was stopped")
    hint = "what is whole is kept: the same command goes on"
    return f"Blender's process ended by {name}: {why}; {hint}{_tail(log)}"


def _tail(log: Path) -> str:
    lines = log.read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:] if log.is_file() else []
    told = "".join(f"\n  {line}" for line in lines)
    return f". The end of {log}:{told}" if lines else f". It wrote nothing to {log}"

"""The Cycles worker: the job file that it gets, its process and Python, its events, and its end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.scene import Scene, SceneError
from rlbench.apps.render.user import camera_path
from rlbench.errors import RlbenchError

WORKER_VERSION = 1  # raised whenever the worker renders different pixels for the same file
STREAMS = {"path": 0, "referenceA": 1, "referenceB": 2, "pilot": 3}
SEEDS_PER_STREAM = 1024  # in each frame
PARAMETERS = {"max_bounces": int, "world": float, "start": int, "threads": int}  # of --define
PYTHON_VARIABLE = "RLBENCH_CYCLES_PYTHON"  # the Python that has bpy; default this one
WORKER = Path(__file__).parent / "worker" / "worker.py"
TESTED_BPY_VERSION = "4.5.15"  # of bpy, for which settings and passes were measured
LOG_TAIL_LINES = 12  # of a log, in error messages
INSTALL_HINT = (
    f"pip install 'rlbench[cycles]' into a Python 3.11, or `python3.11 -m venv cycles && "
    f"cycles/bin/pip install bpy=={TESTED_BPY_VERSION}` and {PYTHON_VARIABLE}=cycles/bin/python"
)


@dataclass(frozen=True)
class CyclesParameters:
    """The --define values of a scene that Cycles renders; None keeps the file's own."""

    max_bounces: int | None = None  # for all kinds of ray; 0 is direct light only
    world: float | None = None  # radiance of a white sky that replaces the file's
    start: int | None = None  # the scene's frame that becomes frame 0
    threads: int = 0  # CPU threads, 0: all; no pixel depends on it

    @classmethod
    def parse(cls, pairs: tuple[tuple[str, str], ...]) -> CyclesParameters:
        """Parameters from (name, value) pairs. Raises SceneError for unknown names and values.

        >>> CyclesParameters.parse((("max_bounces", "6"),)).max_bounces
        6
        """
        values: dict[str, Any] = {}
        for name, value in pairs:
            if name not in PARAMETERS:
                raise SceneError(
                    f"--define {name}={value}: Cycles takes {', '.join(PARAMETERS)}. Make other "
                    "changes in the file"
                )
            try:
                values[name] = PARAMETERS[name](value)
            except ValueError as error:
                raise SceneError(f"--define {name}={value}: {value!r} is not a number") from error
            if name != "start" and not 0 <= values[name] < float("inf"):
                raise SceneError(f"--define {name}={value}: {name} must be a number from 0")
        return cls(**values)

    @property
    def content_key(self) -> str:
        """The parameters that pixels depend on."""
        return f"{self.max_bounces} {self.world} {self.start}"


@dataclass(frozen=True)
class ImageTask:
    """One EXR file for the worker to write: samples first to first + spp - 1 of a seed.

    Sample 0 is excluded, because Cycles sends it through pixel centres. The `total` samples of one
    seed are stratified together, also if several files share them.
    """

    file: Path
    frame: int
    seed: int
    spp: int = 1
    first: int = 1
    total: int = 1

    @property
    def json(self) -> dict[str, Any]:
        """The entry in the job file."""
        return {
            "file": str(self.file.absolute()),
            "frame": self.frame,
            "seed": self.seed,
            "spp": self.spp,
            "first": self.first,
            "total": self.total,
        }


def image_seed(frame: int, stream: str, number: int) -> int:
    """Cycles' seed for image `number` of a stream; all are distinct and below 2^31.

    Raises SceneError if the frame has more images than seeds.
    """
    if not 0 <= number < SEEDS_PER_STREAM:
        raise SceneError(
            f"{stream}: image {number} of one frame was requested, but each stream has "
            f"{SEEDS_PER_STREAM} seeds per frame. Use a preset with fewer samples"
        )
    return (frame * len(STREAMS) + STREAMS[stream]) * SEEDS_PER_STREAM + number


def inspect_job(
    file: Path, frames: int, size: tuple[int, int] | None, parameters: CyclesParameters
) -> dict[str, Any]:
    """A job that renders nothing and describes the contents of a scene file."""
    return {
        "scene": str(file.absolute()),
        "frames": frames,
        "start": parameters.start,
        "size": size,
        "renders": [],
    }


def render_job(
    file: Path,
    scene: Scene,
    start: int,
    frames: int,
    size: tuple[int, int],
    parameters: CyclesParameters,
    images: list[ImageTask],
    geometry: bool = False,
) -> dict[str, Any]:
    """A job that renders `images` of a scene file with the camera of `scene`.

    With `geometry`, the passes of a G-buffer at pixel centres in place of radiance.
    """
    cameras = [scene.camera(float(index)) for index in range(-1, frames + 1)]
    matrices = [convert_axes(camera_path.matrix_from_camera(camera)).tolist() for camera in cameras]
    return {
        "scene": str(file.absolute()),
        "frames": frames,
        "start": start,
        "size": size,
        "camera": {"matrices": matrices, "fov": [camera.fov for camera in cameras]},
        "max_bounces": parameters.max_bounces,
        "world": parameters.world,
        "threads": parameters.threads,
        "geometry": geometry,
        "renders": [image.json for image in images],
    }


def wander_job(
    file: Path, walks: list[Float[Array, "frames 4 4"]], fov: float, seed: int
) -> dict[str, Any]:
    """A job that renders nothing and places each walk in a room of a scene file.

    Walks are camera-to-start in Blender's convention; `fov` is horizontal, in degrees.
    """
    moves = [walk.tolist() for walk in walks]
    job = inspect_job(file, 0, None, CyclesParameters())
    return job | {"wander": {"seed": seed, "fov": fov, "moves": moves}}


def export_job(file: Path, meshes: Path) -> dict[str, Any]:
    """A job that renders nothing and exports the meshes of a scene file to a GLB file."""
    return inspect_job(file, 0, None, CyclesParameters()) | {"export": str(meshes.absolute())}


def convert_axes(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """A camera-to-world matrix in Blender's convention from Mitsuba's, or the reverse."""
    return np.asarray(matrix * np.array([-1.0, 1.0, -1.0, 1.0]))


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
    return f"the Cycles worker failed: {message}{log_tail(log)}"


def _exit_message(code: int, log: Path) -> str:
    """Why the process ended too early, as far as its exit code tells."""
    if code >= 0:
        return f"Blender's process ended with exit code {code} before it was done{log_tail(log)}"
    name = signal.Signals(-code).name
    reason = {
        "SIGKILL": "it was killed, by a user or because the machine ran out of memory",
        "SIGSEGV": "it crashed (segmentation fault)",
        "SIGABRT": "it aborted, often because it ran out of memory",
    }.get(name, "it was stopped")
    hint = "finished images are kept; the same command resumes"
    return f"Blender's process ended by {name}: {reason}; {hint}{log_tail(log)}"


def log_tail(log: Path) -> str:
    """The end of a log, as the end of an error message."""
    lines = log.read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:] if log.is_file() else []
    text = "".join(f"\n  {line}" for line in lines)
    return f". The end of {log}:{text}" if lines else f". It wrote nothing to {log}"

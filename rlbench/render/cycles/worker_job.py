"""The job file of the Cycles worker: which images, of which seeds, from which camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.scene import Scene, SceneError
from rlbench.render.user import camera_path

__all__ = [
    "CyclesParameters",
    "ImageTask",
    "convert_axes",
    "image_seed",
    "inspect_job",
    "render_job",
    "wander_job",
]

WORKER_VERSION = 1  # raised whenever the worker renders different pixels for the same file
STREAMS = {"path": 0, "referenceA": 1, "referenceB": 2, "pilot": 3}
SEEDS_PER_STREAM = 1024  # in each frame
PARAMETERS = {"max_bounces": int, "world": float, "start": int, "threads": int}  # of --define


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


def convert_axes(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """A camera-to-world matrix in Blender's convention from Mitsuba's, or the reverse."""
    return np.asarray(matrix * np.array([-1.0, 1.0, -1.0, 1.0]))

"""The job file that the worker gets: which pictures, of which seeds, from which camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.scene import Scene, SceneError
from rlbench.render.user import camera_path

WORKER_VERSION = 1  # raised whenever the worker makes other pixels of the same file
STREAMS = {"path": 0, "referenceA": 1, "referenceB": 2, "pilot": 3}
SEEDS_PER_STREAM = 1024  # seeds of one stream in one frame
PARAMETERS = {"max_bounces": int, "world": float, "start": int, "threads": int}  # of --define


@dataclass(frozen=True)
class CyclesParameters:
    """What --define says of a scene that Cycles renders; None is as the file has it."""

    max_bounces: int | None = None  # of every kind of ray; 0 is direct light only
    world: float | None = None  # radiance of a white sky that replaces the file's
    start: int | None = None  # the scene's frame that becomes frame 0
    threads: int = 0  # of the processor; 0: all. No pixel depends on it

    @classmethod
    def parse(cls, pairs: tuple[tuple[str, str], ...]) -> CyclesParameters:
        """From `name=value`. Raises SceneError for unknown names and values."""
        found: dict[str, Any] = {}
        for name, value in pairs:
            if name not in PARAMETERS:
                raise SceneError(
                    f"--define {name}={value}: Cycles takes {', '.join(PARAMETERS)}; other things "
                    "are changed in the file"
                )
            try:
                found[name] = PARAMETERS[name](value)
            except ValueError as error:
                raise SceneError(f"--define {name}={value}: {value!r} is no number") from error
            if name != "start" and not 0 <= found[name] < float("inf"):
                raise SceneError(f"--define {name}={value}: it takes a number from 0")
        return cls(**found)

    @property
    def content_key(self) -> str:
        """All that pixels depend on."""
        return f"{self.max_bounces} {self.world} {self.start}"


@dataclass(frozen=True)
class ImageTask:
    """One EXR file that the worker is to write: samples first ... first + spp - 1 of a seed.

    Sample 0 is never among them, for Cycles sends it through pixel centres. `total` samples of one
    seed are stratified together, however they are shared out among pictures.
    """

    file: Path
    frame: int
    seed: int
    spp: int = 1
    first: int = 1
    total: int = 1

    @property
    def json(self) -> dict[str, Any]:
        """As the job file has it."""
        return {
            "file": str(self.file.absolute()),
            "frame": self.frame,
            "seed": self.seed,
            "spp": self.spp,
            "first": self.first,
            "total": self.total,
        }


def image_seed(frame: int, stream: str, number: int) -> int:
    """Cycles' seed of picture `number` of a stream; no two are the same. Below 2^31."""
    if not 0 <= number < SEEDS_PER_STREAM:
        raise SceneError(
            f"{stream}: {number} pictures of one frame; Cycles has {SEEDS_PER_STREAM} seeds"
        )
    return (frame * len(STREAMS) + STREAMS[stream]) * SEEDS_PER_STREAM + number


def inspect_job(
    file: Path, frames: int, size: tuple[int, int] | None, parameters: CyclesParameters
) -> Any:
    """The job that renders nothing and says what a file holds."""
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
    """The job that renders `pictures` of a scene file, seen by the camera of `scene`.

    `geometry`: the passes of a view, of pixel centres, instead of radiance.
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
        "renders": [picture.json for picture in images],
    }


def convert_axes(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """A camera-to-world matrix of Mitsuba's convention in Blender's, or the other way around."""
    return np.asarray(matrix * np.array([-1.0, 1.0, -1.0, 1.0]))

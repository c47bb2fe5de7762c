"""Short random camera paths in the rooms of a Blender scene, as files for `--camera`.

The worker finds places by ray casts: a floor below a ceiling, no surface near, depth in the view.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.cycles.process import run_worker
from rlbench.render.cycles.worker_job import convert_axes, wander_job
from rlbench.render.scene import SceneError
from rlbench.render.user import camera_path
from rlbench.system import paths

__all__ = ["FOV", "place_cameras", "walk"]

FOV = 65.0  # horizontal, degrees
PACE = (0.01, 0.04)  # metres per frame
TURN = 1.0  # degrees per frame, at most, to either side
ASIDE = 60.0  # degrees between the first view and the first step, at most
WALKS_PER_SEED = 1000
PITCH = (-12.0, 2.0)  # degrees above the horizon


def walk(seed: int, frames: int) -> Float[Array, "frames 4 4"]:
    """A random walk of a camera, relative to the place and the heading at its start.

    Step and turn are the same in every frame, so that the camera moves along an arc. Matrices are
    camera-to-start in Blender's convention (the camera looks along -z, y is up); at the start, x is
    to the right, y ahead and z up, in metres.
    """
    chance = np.random.default_rng(seed)
    pace = chance.uniform(*PACE)
    turn, aside = (np.radians(chance.uniform(-most, most)) for most in (TURN, ASIDE))
    pitch = np.radians(chance.uniform(*PITCH))
    headings = turn * np.arange(frames)  # to the left
    steps = pace * np.column_stack([-np.sin(headings + aside), np.cos(headings + aside)])
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[1:, :2, 3] = np.cumsum(steps, 0)[:-1]
    for matrix, heading in zip(matrices, headings, strict=True):
        sine, cosine = np.sin(heading), np.cos(heading)
        ahead = np.array([-sine * np.cos(pitch), cosine * np.cos(pitch), np.sin(pitch)])
        right = np.array([cosine, sine, 0.0])
        matrix[:3, :3] = np.stack([right, np.cross(right, ahead), -ahead], 1)
    return matrices


def place_cameras(file: Path, folder: Path, count: int, frames: int, seed: int = 0) -> list[Path]:
    """Write `count` camera paths for a scene file to `folder`; returns the JSON files.

    Each is one for `rlbench render --camera`, named `walk0.json` and so on. They are kept if
    all exist and have `frames` matrices; more paths leave the first as they were. Raises SceneError
    if the scene has too few places to stand, and CyclesError if Blender is missing or failed.
    """
    files = [folder / f"walk{number}.json" for number in range(count)]
    if all(f.is_file() and len(camera_path.read_matrices(f)[0]) == frames for f in files):
        return files
    walks = [walk(WALKS_PER_SEED * seed + number, frames) for number in range(count)]
    for path, placed in zip(files, _place(file, walks, seed, folder / "cameras.log"), strict=True):
        matrices = [convert_axes(np.array(rows)).tolist() for rows in placed]
        with paths.atomic_write(path) as temporary:
            temporary.write_text(json.dumps({"camera_to_world": matrices, "fov": FOV}))
    return files


def _place(
    file: Path, walks: list[Float[Array, "frames 4 4"]], seed: int, log: Path
) -> list[list[list[float]]]:
    """A camera-to-world path in Blender's convention for each walk."""
    found: list[list[list[float]]] = []
    reasons: dict[str, int] = {}
    for event in run_worker(wander_job(file, walks, FOV, seed), log):
        if event.get("event") == "placed":
            found, reasons = event["paths"], event["rejected"]
    if len(found) < len(walks):
        why = ", ".join(f"{count} times {reason}" for reason, count in reasons.items())
        raise SceneError(
            f"{file}: {len(found)} of {len(walks)} camera paths have a place ({why or 'no mesh'}). "
            "Ask for fewer or shorter paths, or write one by hand: docs/how-to/add-a-scene.md"
        )
    return found

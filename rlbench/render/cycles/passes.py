"""What Cycles writes, in the conventions of a clip: radiance, albedo, normal, depth, motion.

Geometry is rendered with one sample, number 0, which Cycles sends through pixel centres; depth is
written by no other. Found by comparing with analytic scenes, Blender 4.5.15.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.exr import read_exr
from rlbench.render.pose import Pose
from rlbench.render.scene import Scene

LAYER = "view"  # as the worker names the view layer
BACKGROUND_DEPTH = 1e9  # depth from which on nothing is seen: Cycles writes 1e10
MIN_NORMAL_LENGTH = 0.1  # length below which there is no normal
GEOMETRY = [
    *(f"{LAYER}.Denoising Albedo.{c}" for c in "RGB"),
    *(f"{LAYER}.Normal.{c}" for c in "XYZ"),
    f"{LAYER}.Depth.Z",
    *(f"{LAYER}.Vector.{c}" for c in "XY"),
]
COMBINED = [f"{LAYER}.Combined.{c}" for c in "RGB"]


def read_gbuffer(
    file: Path, scene: Scene, index: int, size: tuple[int, int]
) -> dict[str, Float[Array, "h w channels"]]:
    """The view of frame `index` from its geometry file. Raises ClipError where it is broken."""
    return convert_passes(read_exr(file, GEOMETRY, *size).astype(np.float32), scene, float(index))


def convert_passes(
    planes: Float[Array, "9 h w"], scene: Scene, time: float
) -> dict[str, Float[Array, "h w channels"]]:
    """The buffers of a view from the channels GEOMETRY, float32, in the conventions of `View`.

    Albedo is Cycles' denoising albedo, which follows mirrors and glass; cut to [0, 1], as of what
    glows it holds the emission, and 0 for background. Normals are made unit length. Depth is along
    the view axis already; background becomes +inf. Cycles' Vector is (previous - current) with y
    up, so y is negated; it is 0 for background, whose motion is the camera's rotation.
    """
    albedo, normal, depth, vector = np.split(np.moveaxis(planes, 0, -1), [3, 6, 7], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    empty = (depth > BACKGROUND_DEPTH) | (length < MIN_NORMAL_LENGTH)
    motion = vector * np.array([1, -1], np.float32)
    return {
        "albedo": np.where(empty, 0, np.clip(np.nan_to_num(albedo), 0, 1)).astype(np.float32),
        "normal": np.where(empty, 0, normal / np.maximum(length, MIN_NORMAL_LENGTH)).astype(
            np.float32
        ),
        "depth": np.where(empty, np.inf, depth).astype(np.float32),
        "motion": np.where(empty, sky_motion(scene, time, *empty.shape[:2]), motion).astype(
            np.float32
        ),
    }


def sky_motion(scene: Scene, time: float, height: int, width: int) -> Float[Array, "h w 2"]:
    """Pixels to the previous position of what is infinitely far away, from the camera alone."""
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    towards = Pose.at_time(scene, time).ray_directions(film, height, width)
    before = Pose.at_time(scene, time - 1)
    there, _ = before.project(np.column_stack([towards, np.zeros(len(film))]), height, width)
    return np.asarray(there - film).reshape(height, width, 2)


def read_radiance(file: Path, size: tuple[int, int]) -> Float[Array, "h w 3"]:
    """Linear radiance of a file, float32. Raises ClipError where it is broken."""
    return np.moveaxis(read_exr(file, COMBINED, *size).astype(np.float32), 0, -1)

"""Converts Cycles' passes to the conventions of a clip: radiance, albedo, normal, depth, motion.

Geometry is rendered with sample 0 alone, which Cycles sends through pixel centres, and which is the
only sample to write depth. Verified against analytic scenes with Blender 4.5.15.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.exr import read_exr
from rlbench.render.pose import Pose
from rlbench.render.scene import Scene

__all__ = ["GEOMETRY", "convert_passes", "read_gbuffer", "read_radiance", "sky_motion"]

LAYER = "view"  # the worker's name for the view layer
BACKGROUND_DEPTH = 1e9  # Cycles writes 1e10 for background
MIN_NORMAL_LENGTH = 0.1  # shorter normals are background
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
    """The G-buffer of frame `index` from its geometry file. Raises ClipError if it is broken."""
    return convert_passes(read_exr(file, GEOMETRY, *size).astype(np.float32), scene, float(index))


def convert_passes(
    planes: Float[Array, "9 h w"], scene: Scene, time: float
) -> dict[str, Float[Array, "h w channels"]]:
    """The G-buffer from the channels GEOMETRY, float32, in the conventions of `GBuffer`.

    Albedo is Cycles' denoising albedo, which follows mirrors and glass; it is clipped to [0, 1],
    because it contains the emission of emitters, and is 0 for background. Normals are normalized.
    Depth is already along the view axis; background becomes +inf. Cycles' Vector is (previous -
    current) with y up, so y is negated; it is 0 for background, whose motion is computed from the
    camera's rotation.
    """
    albedo, normal, depth, vector = np.split(np.moveaxis(planes, 0, -1), [3, 6, 7], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    empty = (depth > BACKGROUND_DEPTH) | (length < MIN_NORMAL_LENGTH)
    motion = vector * np.array([1, -1], np.float32)
    sky = sky_motion(scene, time, *empty.shape[:2])
    unit_normal = normal / np.maximum(length, MIN_NORMAL_LENGTH)
    return {
        "albedo": np.where(empty, 0, np.clip(np.nan_to_num(albedo), 0, 1)).astype(np.float32),
        "normal": np.where(empty, 0, unit_normal).astype(np.float32),
        "depth": np.where(empty, np.inf, depth).astype(np.float32),
        "motion": np.where(empty, sky, motion).astype(np.float32),
    }


def sky_motion(scene: Scene, time: float, height: int, width: int) -> Float[Array, "h w 2"]:
    """Motion vectors of points at infinity, in pixels, from the camera alone."""
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    directions = Pose.at_time(scene, time).ray_directions(film, height, width)
    points = np.column_stack([directions, np.zeros(len(film))])
    previous, _ = Pose.at_time(scene, time - 1).project(points, height, width)
    return np.asarray(previous - film).reshape(height, width, 2)


def read_radiance(file: Path, size: tuple[int, int]) -> Float[Array, "h w 3"]:
    """Linear radiance of an image, float32. Raises ClipError if the file is broken."""
    return np.moveaxis(read_exr(file, COMBINED, *size).astype(np.float32), 0, -1)

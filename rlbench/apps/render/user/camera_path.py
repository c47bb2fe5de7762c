"""Camera paths of a user's scene: 4x4 matrices, one per frame, or an orbit or dolly from one view.

A matrix is camera-to-world in Mitsuba's convention: the camera looks along its +z axis, +y is up
and +x points to the LEFT of the image; columns 0 to 2 are these axes in world space, column 3 is
the position of the camera. To convert a matrix of Blender or OpenGL, whose camera looks along -z
with x to the right, negate its columns 0 and 2.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.scene import Camera, SceneError

ORBIT_STEP = np.radians(0.5)  # radians per frame
DOLLY_STEP = 0.02  # fraction of the remaining distance per frame
RIGID_TOLERANCE = 1e-3  # deviation of the axes' dot products from those of a rotation

NEARLY_RIGID = 2e-2  # the same for axes that are 1 % too long

MatrixPath = Callable[[float], Float[Array, "4 4"]]  # camera-to-world at a time, in frames


def read_matrices(file: Path) -> tuple[list[Float[Array, "4 4"]], float | None]:
    """The matrices of a JSON file, and its horizontal field of view in degrees, or None.

    The file holds a list of 4x4 matrices, each a list of four rows, or an object with that list as
    "camera_to_world" and optionally a number "fov". Raises SceneError for anything else.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(
            f"--camera {file} cannot be read ({error}). --camera takes still, orbit, dolly, or a "
            "JSON file of camera-to-world matrices"
        ) from error
    matrices = content.get("camera_to_world") if isinstance(content, dict) else content
    fov = content.get("fov") if isinstance(content, dict) else None
    if not isinstance(matrices, list) or not matrices:
        raise SceneError(
            f"{file} has no list of matrices; expected [[[4 numbers] x 4], ...] or "
            '{"camera_to_world": [...], "fov": degrees}'
        )
    if fov is not None and not (isinstance(fov, int | float) and 0 < fov < 180):
        raise SceneError(f"{file}: fov is {fov!r}; expected horizontal degrees between 0 and 180")
    return [check_rigid(matrix, f"{file}, matrix {i}") for i, matrix in enumerate(matrices)], fov


def check_rigid(matrix: object, source: str) -> Float[Array, "4 4"]:
    """`matrix` as float64 if it is a rotation and a translation.

    Raises SceneError otherwise; `source` tells the user which matrix it is.
    """
    try:
        checked = np.array(matrix, np.float64)
    except (TypeError, ValueError):
        checked = np.empty(0)
    if checked.shape != (4, 4) or not np.isfinite(checked).all():
        raise SceneError(f"{source} does not consist of four rows of four finite numbers")
    if abs(checked[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise SceneError(
            f"{source}: its last row is {checked[3].tolist()}, expected [0, 0, 0, 1]. Positions "
            "belong in the last column; the matrix may have to be transposed"
        )
    axes = checked[:3, :3]
    if abs(axes.T @ axes - np.eye(3)).max() > RIGID_TOLERANCE:
        lengths = ", ".join(f"{length:.4g}" for length in np.linalg.norm(axes, axis=0))
        raise SceneError(
            f"{source} is not rigid: its axes have lengths {lengths}, expected 1, 1, 1 at right "
            "angles. Remove scale and shear"
        )
    if np.linalg.det(axes) < 0:
        raise SceneError(
            f"{source} mirrors the image (its determinant is -1). Mitsuba's x axis points to the "
            "left: negate the first column"
        )
    return checked


def straighten(matrix: Float[Array, "4 4"]) -> tuple[Float[Array, "4 4"], list[str]]:
    """A sensor's matrix, if it is rigid to 1 %, as the nearest rigid one, and notes.

    A mirrored one is turned back: the image is not mirrored. Others are returned as they are.
    """
    axes = matrix[:3, :3].copy()
    notes: list[str] = []
    if abs(axes.T @ axes - np.eye(3)).max() > NEARLY_RIGID:
        return matrix, notes
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
        notes.append("the sensor mirrors the image; it is rendered without")
    left, _, right = np.linalg.svd(axes)
    straight = matrix.copy()
    if abs(axes.T @ axes - np.eye(3)).max() > RIGID_TOLERANCE:
        axes = left @ right
        notes.append("the sensor's matrix is rigid to 1 % alone; the nearest rotation is used")
    straight[:3, :3] = axes
    return straight, notes


def camera_from_matrix(matrix: Float[Array, "4 4"], fov: float) -> Camera:
    """The pinhole of a camera-to-world matrix; `fov` is horizontal, in degrees."""
    position, forward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    origin, target, above = (tuple(v.tolist()) for v in (position, position + forward, up))
    return Camera(origin, target, above, fov)


def matrix_from_camera(camera: Camera) -> Float[Array, "4 4"]:
    """The camera-to-world matrix of a pinhole."""
    forward = np.subtract(camera.target, camera.origin, dtype=np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([-right, np.cross(right, forward), forward, camera.origin], 1)
    return matrix


def follow_matrices(matrices: Sequence[Float[Array, "4 4"]]) -> MatrixPath:
    """One matrix per frame; the camera stands still before the first and after the last."""
    return lambda time: matrices[int(np.clip(round(time), 0, len(matrices) - 1))]


def orbit(start: Float[Array, "4 4"], distance: float, frames: int) -> MatrixPath:
    """Half a degree per frame around the point `distance` ahead; the middle frame is `start`.

    The axis is the world axis nearest to the camera's up vector.
    """
    pivot = start[:3, 3] + distance * start[:3, 2]
    axis = int(np.argmax(abs(start[:3, 1])))
    one, two = [(1, 2), (2, 0), (0, 1)][axis]

    def at(time: float) -> Float[Array, "4 4"]:
        angle = ORBIT_STEP * (time - (frames - 1) / 2)
        rotation = np.eye(3)
        rotation[one, one] = rotation[two, two] = np.cos(angle)
        rotation[two, one], rotation[one, two] = np.sin(angle), -np.sin(angle)
        matrix = np.eye(4)
        matrix[:3, :3] = rotation @ start[:3, :3]
        matrix[:3, 3] = pivot + rotation @ (start[:3, 3] - pivot)
        return matrix

    return at


def dolly(start: Float[Array, "4 4"], distance: float) -> MatrixPath:
    """From `start` towards the point `distance` ahead, 2 % of the remaining way per frame."""

    def at(time: float) -> Float[Array, "4 4"]:
        matrix = start.copy()
        matrix[:3, 3] += distance * (1 - (1 - DOLLY_STEP) ** time) * start[:3, 2]
        return matrix

    return at

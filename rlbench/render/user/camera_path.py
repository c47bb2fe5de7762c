"""Camera paths of a user's scene: 4x4 matrices, one a frame, and short ones made from one view.

A matrix is camera-to-world in Mitsuba's convention: the camera looks along its +z axis, +y is up
and +x points to the LEFT of the picture; columns 0 to 2 are these axes in world space, column 3 is
the camera's position. A matrix of Blender or OpenGL, whose camera looks along -z with x to the
right, becomes one by negating its columns 0 and 2.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.scene import Camera, SceneError

TURN = np.radians(0.5)  # an orbit's step from frame to frame
ADVANCE = 0.02  # a dolly's step, of what is left of the way to what it looks at
RIGID = 1e-3  # how far the axes' lengths and angles may be from those of a rotation

MatrixPath = Callable[[float], Float[Array, "4 4"]]  # camera-to-world at a time, in frames


def read_matrices(file: Path) -> tuple[list[Float[Array, "4 4"]], float | None]:
    """The matrices of a JSON file, and its horizontal field of view in degrees if it has one.

    The file holds a list of 4x4 matrices, each a list of four rows, or an object with that list as
    "camera_to_world" and perhaps a number "fov". Raises SceneError.
    """
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(
            f"--camera {file} cannot be read ({error}); it takes still, orbit, dolly, or a JSON "
            "file of camera-to-world matrices"
        ) from error
    listed = found.get("camera_to_world") if isinstance(found, dict) else found
    fov = found.get("fov") if isinstance(found, dict) else None
    if not isinstance(listed, list) or not listed:
        raise SceneError(
            f"{file} has no list of matrices; expected [[[4 numbers] x 4], ...] or "
            '{"camera_to_world": [...], "fov": degrees}'
        )
    if fov is not None and not (isinstance(fov, int | float) and 0 < fov < 180):
        raise SceneError(f"{file}: fov is {fov!r}; expected degrees between 0 and 180, horizontal")
    return [check_rigid(matrix, f"{file}, matrix {i}") for i, matrix in enumerate(listed)], fov


def check_rigid(matrix: object, where: str) -> Float[Array, "4 4"]:
    """`matrix` as float64, if it is a rotation and a translation. Raises SceneError."""
    try:
        found = np.array(matrix, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (4, 4) or not np.isfinite(found).all():
        raise SceneError(f"{where} is not four rows of four finite numbers")
    if abs(found[3] - [0, 0, 0, 1]).max() > RIGID:
        raise SceneError(
            f"{where}: its last row is {found[3].tolist()}, expected [0, 0, 0, 1]; "
            "positions belong in the last column, so it may have to be transposed"
        )
    axes = found[:3, :3]
    if abs(axes.T @ axes - np.eye(3)).max() > RIGID:
        lengths = ", ".join(f"{length:.4g}" for length in np.linalg.norm(axes, axis=0))
        raise SceneError(
            f"{where} is not rigid: its axes have lengths {lengths}, expected 1, 1, 1 at right "
            "angles; remove scale and shear"
        )
    if np.linalg.det(axes) < 0:
        raise SceneError(
            f"{where} mirrors the picture (its determinant is -1); Mitsuba's x axis points to the "
            "left: negate the first column"
        )
    return found


def camera_from_matrix(matrix: Float[Array, "4 4"], fov: float) -> Camera:
    """The pinhole of a camera-to-world matrix; `fov` is horizontal, in degrees."""
    place, forward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    origin, target, above = (tuple(v.tolist()) for v in (place, place + forward, up))
    return Camera(origin, target, above, fov)


def matrix_from_camera(camera: Camera) -> Float[Array, "4 4"]:
    """The camera-to-world matrix of a pinhole."""
    forward = np.subtract(camera.target, camera.origin, dtype=np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    made = np.eye(4)
    made[:3] = np.stack([-right, np.cross(right, forward), forward, camera.origin], 1)
    return made


def follow_matrices(matrices: Sequence[Float[Array, "4 4"]]) -> MatrixPath:
    """The matrices one after the other; before the first and after the last nothing moves."""
    return lambda time: matrices[int(np.clip(round(time), 0, len(matrices) - 1))]


def orbit(start: Float[Array, "4 4"], distance: float, frames: int) -> MatrixPath:
    """Half a degree a frame around the point `distance` ahead; the middle frame is `start`.

    The axis is the world's x, y or z, whichever is nearest to the camera's up.
    """
    pivot = start[:3, 3] + distance * start[:3, 2]
    axis = int(np.argmax(abs(start[:3, 1])))
    one, two = [(1, 2), (2, 0), (0, 1)][axis]

    def at(time: float) -> Float[Array, "4 4"]:
        angle = TURN * (time - (frames - 1) / 2)
        turn = np.eye(3)
        turn[one, one] = turn[two, two] = np.cos(angle)
        turn[two, one], turn[one, two] = np.sin(angle), -np.sin(angle)
        made = np.eye(4)
        made[:3, :3] = turn @ start[:3, :3]
        made[:3, 3] = pivot + turn @ (start[:3, 3] - pivot)
        return made

    return at


def dolly(start: Float[Array, "4 4"], distance: float) -> MatrixPath:
    """From `start` towards the point `distance` ahead, two percent of what is left a frame."""

    def at(time: float) -> Float[Array, "4 4"]:
        made = start.copy()
        made[:3, 3] += distance * (1 - (1 - ADVANCE) ** time) * start[:3, 2]
        return made

    return at

"""A box that slides over a floor, under a uniform sky, seen by a camera that circles it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rlbench.apps.render import Camera, Mesh, Scene

CORNERS = [(x, y, z) for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]  # metres, z is up
SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
FLOOR = [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)]
STEP = 0.05  # of the box, metres a frame
START, TURN = math.radians(30), math.radians(1)  # of the camera: at frame 0, and a frame


def scene() -> Scene:
    """The scene; time is in frames, and equal times give equal poses."""
    box = _mesh("box", CORNERS, SIDES, (0.8, 0.3, 0.2))
    floor = _mesh("floor", FLOOR, [(0, 1, 2, 3)], (0.6, 0.6, 0.6))
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}

    def move(time: float) -> Mapping[str, NDArray[np.float32]]:
        return {"box": box.vertices + np.array([STEP * time, 0, 0], np.float32)}

    return Scene(
        "${name}_scene", "A box on a floor", (floor, box), _camera, (sky,), vertex_animation=move
    )


def _camera(time: float) -> Camera:
    angle = START + TURN * time
    return Camera((4 * math.sin(angle), -4 * math.cos(angle), 2.0), (0.0, 0.0, 0.5), fov=50.0)


def _mesh(
    name: str,
    vertices: Sequence[tuple[float, float, float]],
    quads: Sequence[tuple[int, int, int, int]],
    color: tuple[float, float, float],
) -> Mesh:
    """A diffuse mesh of quads, whose corners run counter-clockwise seen from outside."""
    faces = [corners for a, b, c, d in quads for corners in ((a, b, c), (a, c, d))]
    material = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}
    return Mesh(name, np.array(vertices, np.float32), np.array(faces, np.uint32), material)

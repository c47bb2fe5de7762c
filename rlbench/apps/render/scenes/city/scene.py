"""City: house fronts around a square in the sun, with swaying trees and a car on a ring road.

It tests foliage and other thin geometry, sunlight, glossy panes and metal, and motion.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene
from rlbench.apps.render.scenes.city import trees
from rlbench.apps.render.scenes.city.square import (
    ROAD_RADIUS,
    building_meshes,
    car_paint_bsdf,
    paving_meshes,
)
from rlbench.apps.render.scenes.city.street import build_car
from rlbench.apps.render.scenes.city.trees import LEAF_COLOURS, Tree
from rlbench.apps.render.scenes.parts.materials import palette_texture
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Shape,
    merge,
    paint,
    quads,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.takes import cut_take, static_camera_take

TREES = (
    Tree(-5.0, -6.9, 6.8, 2.3, 3200),
    Tree(-10.2, 7.6, 8.0, 2.8),
    Tree(-5.4, 10.8, 8.8, 3.0, 4000),
    Tree(7.9, 6.4, 9.0, 3.0, 4200),
    Tree(2.6, 10.9, 8.2, 2.7, 3400),
    Tree(-14.6, -3.0, 8.0, 2.8, 2000),
    Tree(-14.8, 2.6, 7.6, 2.6),
    Tree(-15.4, 11.0, 8.8, 2.8, 2400),
)
FLAG_COLOURS = ((0.62, 0.10, 0.07), (0.78, 0.52, 0.10), (0.08, 0.26, 0.46), (0.76, 0.74, 0.68))


def scene() -> Scene:
    """The square on a clear afternoon, with its takes."""
    random = np.random.default_rng(7)
    return Scene(
        name="city",
        title="City: a square with trees in the sun",
        meshes=(*paving_meshes(random), *building_meshes(random, TREES), *_moving_meshes(0.0)),
        camera=_camera,
        sky=(
            {
                "type": "sunsky",
                "turbidity": 3.5,
                "sun_direction": [-0.70, -0.36, 0.56],
                "sun_scale": 1.0,
                "sky_scale": 1.0,
            },
        ),
        vertex_animation=lambda time: {mesh.name: mesh.vertices for mesh in _moving_meshes(time)},
        exposure=5.0,
        takes=(
            static_camera_take(_camera, 40.0),
            cut_take(_camera, _balcony_camera, "sky0", 1.0, 0.3),
        ),  # a cloud covers the sun
    )


def _camera(time: float) -> Camera:
    angle = 0.32 * np.sin(2 * np.pi * time / 125) - 0.16
    origin = (15.0 * np.sin(angle), -14.0 * np.cos(angle), 2.3 + 0.25 * np.sin(time / 30))
    return Camera(origin, (1.2 * np.sin(time / 27), 3.0, 4.0), fov=66)


def _balcony_camera(time: float) -> Camera:
    """A high camera at a corner of the square that moves along it."""
    return Camera((10.8 - 0.08 * time, -12.5, 7.0), (-3.0, 2.5 + 0.05 * time, 2.5), fov=66)


def _moving_meshes(time: float) -> tuple[Mesh, ...]:
    """Leaves and flags in the wind, and the car, at a time."""
    return (_foliage_mesh(time), _car_mesh(time))


def _foliage_mesh(time: float) -> Mesh:
    rest, response = _foliage_at_rest()
    wind = 2 * np.pi * time / 46 + 0.35 * rest.vertices[:, 0] + 0.2 * rest.vertices[:, 1]
    flutter = 2 * np.pi * time / 11 + 12.9 * rest.vertices[:, 0] + 7.3 * rest.vertices[:, 2]
    push = response * (0.16 * np.sin(wind) + 0.03 * np.sin(flutter))
    shift = push[:, None] * np.array([0.8, 0.5, -0.25])
    vertices = (rest.vertices + shift).astype(np.float32)
    leaf_bsdf = {
        "type": "principledthin",
        "base_color": palette_texture(LEAF_COLOURS + FLAG_COLOURS),
        "roughness": 0.6,
        "diff_trans": 0.8,
    }
    return Mesh("foliage", vertices, rest.faces, leaf_bsdf, uv=rest.uv)


@cache
def _foliage_at_rest() -> tuple[Shape, Float32Array]:
    """Leaves and flags without wind, and the wind response of each vertex."""
    size = len(LEAF_COLOURS + FLAG_COLOURS)
    foliage = trees.build_leaves(TREES, size)
    flags = [
        _build_bunting(a, b)
        for a, b in (((-14, 2, 9), (13, 14, 10)), ((-13, 13, 10.5), (14, 1, 9)))
    ]
    rest = merge(foliage, *flags)
    response = np.concatenate(
        [
            trees.wind_response(foliage),
            *(np.tile([0.2, 0.2, 2.0, 2.0], len(flag.vertices) // 4) for flag in flags),
        ]
    )
    return rest, response.astype(np.float32)


def _build_bunting(start: tuple[float, float, float], end: tuple[float, float, float]) -> Shape:
    """A sagging line of flags; each is a quad that hangs from its first two corners."""
    along = np.linspace(0, 1, 40)[:, None]
    line = np.array(start) * (1 - along) + np.array(end) * along
    line[:, 2] -= 4 * 1.8 * along[:, 0] * (1 - along[:, 0])
    across = np.diff(line, axis=0) * 0.75
    flags = quads(line[:-1], across, (0.0, 0.0, -0.55))
    colours = len(LEAF_COLOURS) + np.arange(len(across)) % len(FLAG_COLOURS)
    return paint(flags, colours.repeat(4), len(LEAF_COLOURS + FLAG_COLOURS))


def _car_mesh(time: float) -> Mesh:
    """The car on its circle around the fountain, at a time."""
    angle = 2 * np.pi * time / 190 - 2.3
    position = (ROAD_RADIUS * np.cos(angle), ROAD_RADIUS * np.sin(angle), 0.02)
    return transform(build_car(), position, yaw_matrix(angle + np.pi / 2)).to_mesh(
        "car", car_paint_bsdf(), smooth=True
    )

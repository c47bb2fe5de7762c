"""Ripples: a tiled bath with moving water, glassware, lilies and a mirror.

It tests caustics, reflection, refraction, and motion behind and in water.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene
from rlbench.apps.render.scenes.parts.glassware import build_glass_on_plinths
from rlbench.apps.render.scenes.parts.materials import glossy_bsdf, palette_texture, rgb
from rlbench.apps.render.scenes.parts.shapes import Float64Array, Shape, grid, icosphere, transform
from rlbench.apps.render.scenes.parts.takes import cut_take, static_camera_take
from rlbench.apps.render.scenes.ripples.bath import (
    PLINTHS,
    POOL_HALF_WIDTH,
    clutter_mesh,
    mirror_and_lamp_meshes,
    room_meshes,
)
from rlbench.apps.render.scenes.ripples.lilies import FLOATING_COLOURS, build_floating

DROPS = ((-1.1, 0.4, 0.0), (1.3, -0.9, 21.0), (0.5, 1.7, 43.0))  # x, y, first frame
GLASS_BSDF = {"type": "dielectric", "int_ior": 1.5}


def scene() -> Scene:
    """The bath in the evening: warm light panels above and blue dusk all around."""
    random = np.random.default_rng(31)
    return Scene(
        name="ripples",
        title="Ripples: caustics, glass and a mirror",
        meshes=(
            *room_meshes(random),
            clutter_mesh(random),
            *mirror_and_lamp_meshes(),
            _glassware_mesh(),
            *_moving_meshes(0.0),
        ),
        camera=_camera,
        sky=({"type": "constant", "radiance": rgb(0.15, 0.24, 0.39)},),
        vertex_animation=lambda time: {mesh.name: mesh.vertices for mesh in _moving_meshes(time)},
        exposure=1.8,
        max_depth=8,
        takes=(static_camera_take(_camera, 25.0), cut_take(_camera, _low_camera, "lamp", 0.2, 1.0)),
    )


def _camera(time: float) -> Camera:
    angle = 0.45 * np.sin(2 * np.pi * time / 130) - 0.2
    lift = 2.2 + 0.25 * np.sin(2 * np.pi * time / 130)
    return Camera((4.9 * np.sin(angle), -4.9 * np.cos(angle), lift), (0.1, 0.7, 0.1), fov=58)


def _low_camera(time: float) -> Camera:
    """A camera close to the water, at a corner of the pool, that moves around it."""
    angle = 0.62 + 0.012 * time
    return Camera((4.6 * np.sin(angle), -4.6 * np.cos(angle), 1.2), (0.3, 1.2, 0.1), fov=58)


def _glassware_mesh() -> Mesh:
    return build_glass_on_plinths(PLINTHS).to_mesh("glassware", GLASS_BSDF, smooth=True)


def _water_height(x: Float64Array, y: Float64Array, time: float) -> Float64Array:
    """Height of the water in metres: rings that spread from drops, on a slow swell."""
    level = 0.012 * np.sin(2.1 * x + 1.3 * y + 0.11 * time) + 0.009 * np.sin(
        2.9 * y - 1.7 * x - 0.13 * time
    )
    for at_x, at_y, first in DROPS:
        distance = np.hypot(x - at_x, y - at_y)
        phase = 10.5 * distance - 2 * np.pi * (time - first) / 17
        level = level + 0.042 * np.cos(phase) * np.exp(-0.25 * distance) / np.sqrt(1 + 4 * distance)
    return level


def _moving_meshes(time: float) -> tuple[Mesh, ...]:
    """The water, the objects that float on it, and the glass ball above it, at a time."""
    sheet = _water_grid()
    x, y = sheet.vertices[:, 0].astype(float), sheet.vertices[:, 1].astype(float)
    water = sheet._replace(
        vertices=np.stack([x, y, _water_height(x, y, time)], -1).astype(np.float32)
    )
    position = (
        -0.35 + 0.5 * np.sin(2 * np.pi * time / 120),
        0.55,
        0.85 + 0.15 * np.sin(2 * np.pi * time / 70),
    )
    orb = transform(icosphere(5), position, scale=0.5)
    return (
        water.to_mesh("water", {"type": "dielectric", "int_ior": 1.33}, smooth=True),
        build_floating(_water_height, time).to_mesh(
            "floats", glossy_bsdf(palette_texture(FLOATING_COLOURS), 0.12), smooth=True
        ),
        orb.to_mesh("orb", GLASS_BSDF, smooth=True),
    )


@cache
def _water_grid() -> Shape:
    return grid(2 * POOL_HALF_WIDTH + 0.1, 2 * POOL_HALF_WIDTH + 0.1, (110, 110))

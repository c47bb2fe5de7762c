"""Ripples: a tiled bath whose moving water throws caustics, with glass, lilies and a mirror."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.parts.glassware import on_plinths
from rlbench.scenes.parts.shapes import Shape, ball, grid, placed
from rlbench.scenes.parts.takes import cut, static
from rlbench.scenes.parts.textures import glossy, palette, rgb
from rlbench.scenes.ripples.bath import HALF, PLINTHS, clutter, fittings, room
from rlbench.scenes.ripples.lilies import COLOURS, afloat

DROPS = ((-1.1, 0.4, 0.0), (1.3, -0.9, 21.0), (0.5, 1.7, 43.0))  # x, y, first frame
GLASS = {"type": "dielectric", "int_ior": 1.5}


def scene() -> Scene:
    """The bath in the evening: two warm panels of light above, blue dusk all around."""
    random = np.random.default_rng(31)
    return Scene(
        name="ripples",
        title="Ripples: caustics, glass and a mirror",
        meshes=(*room(random), clutter(random), *fittings(), _glassware(), *_movers(0.0)),
        camera=_camera,
        sky=({"type": "constant", "radiance": rgb(0.15, 0.24, 0.39)},),
        vertex_animation=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=1.8,
        depth=8,
        takes=(static(_camera, 25.0), cut(_camera, _low, "lamp", 0.2, 1.0)),
    )


def _camera(time: float) -> Camera:
    angle = 0.45 * np.sin(2 * np.pi * time / 130) - 0.2
    lift = 2.2 + 0.25 * np.sin(2 * np.pi * time / 130)
    return Camera((4.9 * np.sin(angle), -4.9 * np.cos(angle), lift), (0.1, 0.7, 0.1), fov=58)


def _low(time: float) -> Camera:
    """From near the water, at a corner of the pool, moving around it."""
    angle = 0.62 + 0.012 * time
    return Camera((4.6 * np.sin(angle), -4.6 * np.cos(angle), 1.2), (0.3, 1.2, 0.1), fov=58)


def _glassware() -> Mesh:
    return on_plinths(PLINTHS).mesh("glassware", GLASS, smooth=True)


def _height(x: NDArray[np.float64], y: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Height of the water: rings that spread from drops, on a slow swell, in metres."""
    level = 0.012 * np.sin(2.1 * x + 1.3 * y + 0.11 * time) + 0.009 * np.sin(
        2.9 * y - 1.7 * x - 0.13 * time
    )
    for at_x, at_y, first in DROPS:
        distance = np.hypot(x - at_x, y - at_y)
        phase = 10.5 * distance - 2 * np.pi * (time - first) / 17
        level = level + 0.042 * np.cos(phase) * np.exp(-0.25 * distance) / np.sqrt(1 + 4 * distance)
    return level


def _movers(time: float) -> tuple[Mesh, ...]:
    """The water, what floats on it, and the glass ball above it."""
    sheet = _sheet()
    x, y = sheet.vertices[:, 0].astype(float), sheet.vertices[:, 1].astype(float)
    water = sheet._replace(vertices=np.stack([x, y, _height(x, y, time)], -1).astype(np.float32))
    hover = (
        -0.35 + 0.5 * np.sin(2 * np.pi * time / 120),
        0.55,
        0.85 + 0.15 * np.sin(2 * np.pi * time / 70),
    )
    orb = placed(ball(5), hover, scale=0.5)
    return (
        water.mesh("water", {"type": "dielectric", "int_ior": 1.33}, smooth=True),
        afloat(_height, time).mesh("floats", glossy(palette(COLOURS), 0.12), smooth=True),
        orb.mesh("orb", GLASS, smooth=True),
    )


@cache
def _sheet() -> Shape:
    return grid(2 * HALF + 0.1, 2 * HALF + 0.1, (110, 110))

"""Ripples: a pool whose moving water throws caustics on pebbles, with a glass ball and a mirror."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.shapes import (
    Shape,
    ball,
    boxes,
    grid,
    merge,
    painted,
    placed,
    quads,
    rotation,
    yaw,
)
from rlbench.scenes.takes import cut, static
from rlbench.scenes.textures import bitmap, diffuse, glossy, mix, noise, palette, rgb, tiles

HALF, DEPTH = 3.0, 0.8  # metres: half the pool's side, and its depth; water stands at z = 0
DROPS = ((-1.1, 0.4, 0.0), (1.3, -0.9, 21.0), (0.5, 1.7, 43.0))  # x, y, first frame
PEBBLES = (
    (0.72, 0.18, 0.10),
    (0.85, 0.55, 0.12),
    (0.12, 0.38, 0.50),
    (0.20, 0.45, 0.18),
    (0.75, 0.70, 0.62),
    (0.35, 0.12, 0.38),
    (0.10, 0.10, 0.11),
)
FLOATS = (
    (-0.2, -1.3, 0.26, 0),
    (1.75, 0.9, 0.32, 1),
    (-2.0, -0.7, 0.22, 2),
)  # x, y, radius, colour


def scene() -> Scene:
    """The pool, in a dim blue room with a warm lamp above."""
    random = np.random.default_rng(31)
    return Scene(
        name="ripples",
        title="Ripples: caustics, glass and a mirror",
        meshes=(*_basin(random), _pebbles(random), *_optics(), *_movers(0.0)),
        camera=_camera,
        sky=({"type": "constant", "radiance": rgb(0.29, 0.42, 0.60)},),
        moving=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=1.1,
        depth=8,
        takes=(static(_camera, 25.0), cut(_camera, _low, "lamp", 0.2, 1.0)),
    )


def _camera(time: float) -> Camera:
    angle = 0.45 * np.sin(2 * np.pi * time / 130) - 0.2
    lift = 2.5 + 0.25 * np.sin(2 * np.pi * time / 130)
    return Camera((5.2 * np.sin(angle), -5.2 * np.cos(angle), lift), (0.1, 0.25, 0.0), fov=58)


def _low(time: float) -> Camera:
    """From near the water, at a corner of the pool, moving around it."""
    angle = 0.62 + 0.012 * time
    return Camera((4.6 * np.sin(angle), -4.6 * np.cos(angle), 1.2), (0.3, 1.2, 0.1), fov=58)


def _basin(random: np.random.Generator) -> tuple[Mesh, ...]:
    mosaic = tiles(
        random,
        [(0.30, 0.62, 0.64), (0.34, 0.66, 0.66), (0.26, 0.57, 0.61)],
        (0.16, 0.34, 0.40),
        (6, 6),
        gap=0.05,
    )
    deck = tiles(
        random, [(0.50, 0.40, 0.30), (0.56, 0.46, 0.35)], (0.25, 0.20, 0.16), (3, 3), gap=0.03
    )
    a, b = HALF, HALF + 0.45
    liner = boxes(
        [
            (-b, -b, -DEPTH - 0.2),
            (-b, -b, -DEPTH),
            (a, -b, -DEPTH),
            (-a, -b, -DEPTH),
            (-a, a, -DEPTH),
        ],
        [(b, b, -DEPTH), (-a, b, 0.18), (b, b, 0.18), (a, -a, 0.18), (a, b, 0.18)],
        tile=1.5,
    )
    far = 14.0
    flags = boxes(
        [(-far, -far, -0.4), (b, -far, -0.4), (-b, -far, -0.4), (-b, b, -0.4)],
        [(-b, far, 0.1), (far, far, 0.1), (b, -b, 0.1), (b, far, 0.1)],
        tile=2.4,
    )
    wall = boxes((-far, 6.0, 0), (far, 6.5, 7), tile=3.0)
    plaster = mix((0.42, 0.20, 0.14), (0.55, 0.30, 0.20), noise(random, 128, 0.6))
    return (
        liner.mesh("liner", diffuse(bitmap(mosaic))),
        flags.mesh("deck", glossy(bitmap(deck), 0.2)),
        wall.mesh("wall", diffuse(bitmap(plaster))),
    )


def _pebbles(random: np.random.Generator) -> Mesh:
    """Flat stones on the bottom, and painted blocks that stand in the water."""
    parts = []
    for _ in range(150):
        stone = ball(2)
        stretch = random.uniform(0.06, 0.17) * np.array([1, random.uniform(0.6, 1), 0.5])
        turned = stone._replace(vertices=(stone.vertices * stretch).astype(np.float32))
        x, y = random.uniform(-2.8, 2.8, 2)
        at = (x, y, -DEPTH + 0.6 * stretch[2])
        parts.append(painted(placed(turned, at, yaw(random.uniform(0, 6))), random.integers(7), 7))
    for x, y, size, height, slot in (
        (1.0, 0.3, 0.6, 1.05, 4),
        (-1.5, 1.6, 0.8, 1.3, 0),
        (2.1, 2.0, 0.7, 1.6, 1),
        (-2.3, 2.3, 0.5, 2.0, 2),
    ):
        block = boxes((-size / 2, -size / 2, 0), (size / 2, size / 2, height))
        parts.append(painted(placed(block, (x, y, -DEPTH), yaw(0.5 * x)), slot, 7))
    return merge(*parts).mesh("pebbles", diffuse(palette(PEBBLES)))


def _optics() -> tuple[Mesh, ...]:
    """The mirror behind the pool and the lamp above it."""
    lean = rotation((1, 0, 0), 0.2)  # towards the pool
    glass = placed(quads((-1.7, 0, 0), (3.4, 0, 0), (0, 0, 2.6)), (0.2, 4.4, 0.2), lean)
    bars = boxes(
        [(-1.8, 0.01, -0.1), (-1.8, 0.01, 2.6), (-1.8, -0.05, -0.1), (1.7, -0.05, -0.1)],
        [(1.8, 0.12, 0.0), (1.8, 0.12, 2.7), (-1.7, 0.12, 2.7), (1.8, 0.12, 2.7)],
    )
    frame = placed(bars, (0.2, 4.4, 0.2), lean)
    lamp = quads((-4.2, -1.7, 3.6), (0, 3.3, 0), (8.4, 0, 0))
    return (
        glass.mesh(
            "mirror",
            {
                "type": "twosided",
                "bsdf": {"type": "conductor", "specular_reflectance": rgb(0.9, 0.9, 0.9)},
            },
        ),
        frame.mesh("frame", glossy(rgb(0.30, 0.16, 0.05), 0.1)),
        Mesh(
            "lamp",
            lamp.vertices,
            lamp.faces,
            {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)},
            uv=lamp.uv,
            emission={"type": "area", "radiance": rgb(2.8, 2.1, 1.3)},
        ),
    )


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
    floats = [_float(number, time) for number in range(len(FLOATS))]
    hover = (
        -0.35 + 0.5 * np.sin(2 * np.pi * time / 120),
        0.55,
        0.85 + 0.15 * np.sin(2 * np.pi * time / 70),
    )
    orb = placed(ball(5), hover, scale=0.55)
    return (
        water.mesh("water", {"type": "dielectric", "int_ior": 1.33}, smooth=True),
        merge(*floats).mesh("floats", glossy(palette(PEBBLES), 0.08), smooth=True),
        orb.mesh("orb", {"type": "dielectric", "int_ior": 1.5}, smooth=True),
    )


@cache
def _sheet() -> Shape:
    return grid(2 * HALF + 0.1, 2 * HALF + 0.1, (110, 110))


def _float(number: int, time: float) -> Shape:
    """A two-coloured ball that bobs with the water."""
    x, y, radius, slot = FLOATS[number]
    height = float(_height(np.array(x), np.array(y), time))
    sphere = ball(4)
    slots = np.where(np.abs(sphere.vertices[:, 2]) < 0.3, 4, slot)
    tilt = rotation(
        (np.cos(number), np.sin(number), 0), 0.5 + 0.2 * np.sin(2 * np.pi * time / 40 + number)
    )
    return placed(
        painted(sphere, slots, len(PEBBLES)), (x, y, 1.6 * height + 0.35 * radius), tilt, radius
    )

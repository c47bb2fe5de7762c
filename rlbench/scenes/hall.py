"""Hall: a dark sci-fi hall of metal and drones, lit by tubes and a thousand small lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.lamps import (
    AMBER,
    CYAN,
    HEIGHT,
    LENGTH,
    RADIANCE,
    ROSE,
    WHITE,
    WIDTH,
    Lamps,
    fixed,
    joined,
    tubes,
)
from rlbench.scenes.shapes import (
    Floats,
    Shape,
    ball,
    boxes,
    cylinder,
    lathe,
    merge,
    painted,
    placed,
    quads,
    rotation,
    yaw,
)
from rlbench.scenes.takes import cut, static, still
from rlbench.scenes.textures import bitmap, glossy, metal, palette, rgb, tiles

Point = tuple[float, float, float]

TUBE = (0.40, 0.49, 0.58)  # radiance
DRONES = ((-2.2, 9.0, 2.6), (2.4, 13.0, 3.4), (0.2, 19.0, 2.2), (-3.4, 15.0, 4.6))


def scene() -> Scene:
    """The hall: tubes below the ceiling, and a thousand lamps in four meshes, one a colour."""
    random = np.random.default_rng(23)
    return Scene(
        name="hall",
        title="Hall: tubes and a thousand small lamps",
        meshes=(
            *_building(random),
            _crates(random),
            _shining("tubes", tubes(), TUBE, 3.0),
            *_movers(0.0),
        ),
        camera=_camera,
        moving=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=7.5,
        depth=4,
        takes=(
            static(_camera, 20.0),
            cut(_camera, _from_gallery, "tubes", 1.0, 0.0),
            still(_camera, 45.0),
        ),
    )


def _camera(time: float) -> Camera:
    glide = np.sin(2 * np.pi * time / 140)
    x, y = -1.6 + 1.8 * np.sin(2 * np.pi * time / 110), 1.2 + 3.2 * glide
    return Camera((x, y, 1.7), (0.8 + 1.2 * glide, y + 11, 2.5), fov=70)


def _from_gallery(time: float) -> Camera:
    """From above and the other end, moving along the hall."""
    y = 27.0 - 0.1 * time
    return Camera((4.4, y, 4.6), (-1.5, y - 10, 1.8), fov=70)


def _building(random: np.random.Generator) -> tuple[Mesh, ...]:
    plates = tiles(
        random,
        [(0.34, 0.36, 0.40), (0.28, 0.30, 0.34), (0.40, 0.41, 0.43)],
        (0.06, 0.06, 0.07),
        (4, 4),
        gap=0.02,
    )
    panels = tiles(
        random,
        [(0.10, 0.12, 0.16), (0.14, 0.16, 0.20), (0.20, 0.21, 0.24)],
        (0.02, 0.02, 0.03),
        (4, 3),
        0.5,
        gap=0.05,
    )
    floor = boxes((-WIDTH, -4, -0.3), (WIDTH, LENGTH, 0), tile=4.0)
    shell = boxes(
        [
            (-WIDTH - 0.5, -4, 0),
            (WIDTH, -4, 0),
            (-WIDTH, LENGTH, 0),
            (-WIDTH, -4.5, 0),
            (-WIDTH, -4, HEIGHT),
        ],
        [
            (-WIDTH, LENGTH, HEIGHT),
            (WIDTH + 0.5, LENGTH, HEIGHT),
            (WIDTH, LENGTH + 0.5, HEIGHT),
            (WIDTH, -4, HEIGHT),
            (WIDTH, LENGTH, HEIGHT + 0.5),
        ],
        tile=4.0,
    )
    return (
        floor.mesh("floor", metal(bitmap(plates), 0.3)),
        shell.mesh("shell", glossy(bitmap(panels), 0.25)),
        _ribs().mesh("ribs", metal(rgb(0.42, 0.43, 0.46), 0.3)),
        _pipes().mesh("pipes", metal(rgb(0.60, 0.36, 0.22), 0.22), smooth=True),
    )


def _ribs() -> Shape:
    low: list[Point] = []
    high: list[Point] = []
    for y in np.arange(1.0, LENGTH, 4.0):
        for side in (-1, 1):
            a, b = sorted((side * WIDTH, side * (WIDTH - 0.55)))
            low.append((a, y - 0.3, 0))
            high.append((b, y + 0.3, HEIGHT))
            a, b = sorted((side * WIDTH, side * (WIDTH - 1.1)))
            low.append((a, y - 0.45, 0))
            high.append((b, y + 0.45, 0.9))
        low.append((-WIDTH, y - 0.25, HEIGHT - 0.6))
        high.append((WIDTH, y + 0.25, HEIGHT))
    low += [(-WIDTH, -4, 3.3), (WIDTH - 0.9, -4, 3.3)]
    high += [(-WIDTH + 0.9, LENGTH, 3.5), (WIDTH, LENGTH, 3.5)]  # galleries
    gate = lathe([(2.45, 0.3), (2.45, 1.2), (2.15, 1.3), (2.15, 0.6), (0.5, 0.3), (0.05, 0.9)], 48)
    return merge(
        boxes(low, high),
        placed(gate, (0, LENGTH, 2.9), rotation((1, 0, 0), np.pi / 2)),
        boxes((-2.0, LENGTH - 1.2, 0), (2.0, LENGTH, 0.6)),
    )


def _pipes() -> Shape:
    along = rotation((1, 0, 0), -np.pi / 2)  # upright to along y
    places = [
        (-5.6, 6.0, 0.24),
        (-5.0, 6.1, 0.16),
        (5.4, 5.9, 0.3),
        (4.7, 6.15, 0.14),
        (-6.6, 3.9, 0.12),
        (6.6, 3.9, 0.12),
    ]
    return merge(*(placed(cylinder(r, -4, LENGTH, 20), (x, 0, z), along) for x, z, r in places))


def _crates(random: np.random.Generator) -> Mesh:
    stacks = [
        (-4.6, 6.6, 1.5),
        (-4.3, 8.6, 1.1),
        (4.2, 7.4, 1.7),
        (4.8, 9.6, 1.3),
        (2.9, 11.5, 0.9),
    ]
    stacks += [
        (-3.3, 13.0, 1.2),
        (-4.9, 14.2, 1.8),
        (4.0, 17.0, 1.9),
        (-4.0, 20.5, 1.6),
        (3.1, 23.0, 1.4),
    ]
    parts = []
    for x, y, size in stacks:
        crate = merge(*_crate(random))
        turn = yaw(random.uniform(-0.5, 0.5))
        parts.append(placed(crate, (x, y, 0), turn, size))
        if random.random() < 0.7:
            at = (x + random.uniform(-0.1, 0.1), y, size)
            parts.append(
                placed(merge(*_crate(random)), at, yaw(random.uniform(-0.6, 0.6)), 0.65 * size)
            )
    shape = merge(*parts)
    colours = [(0.55, 0.16, 0.03), (0.05, 0.20, 0.24), (0.35, 0.33, 0.28), (0.06, 0.06, 0.07)]
    return shape.mesh("crates", glossy(palette(colours), 0.2))


def _crate(random: np.random.Generator) -> tuple[Shape, Shape]:
    """A unit crate in one of three colours with dark edges."""
    body = painted(boxes((-0.47, -0.47, 0.03), (0.47, 0.47, 0.97)), random.integers(3), 4)
    low, high = [], []
    for axis in range(3):
        for a in (0.0, 0.9):
            for b in (0.0, 0.9):
                corner = np.array([a, b, 0.0])
                extent = np.array([0.1, 0.1, 1.0])
                low.append(np.roll(corner, axis))
                high.append(np.roll(corner + extent, axis))
    edges = boxes(np.array(low) - (0.5, 0.5, 0), np.array(high) - (0.5, 0.5, 0))
    return body, painted(edges, 3, 4)


def _movers(time: float) -> tuple[Mesh, ...]:
    """The drones, and all lamps, for the drones carry some."""
    hull = merge(
        placed(ball(3), (0, 0, 0), scale=0.3),
        lathe([(0.34, -0.05), (0.62, -0.02), (0.62, 0.04), (0.34, 0.08)], 40),
        boxes((-0.04, -0.04, 0.2), (0.04, 0.04, 0.62)),
    )
    places = [_drone(index, time) for index in range(len(DRONES))]
    drones = merge(*(placed(hull, at, turn) for at, turn in places))
    shining = (_lamp_mesh(_lamps(time), colour) for colour in range(len(RADIANCE)))
    return (
        drones.mesh("drones", metal(rgb(0.75, 0.76, 0.80), 0.12), smooth=True),
        *shining,
    )


def _lamp_mesh(lamps: Lamps, colour: int) -> Mesh:
    """All lamps of one colour; one radiance a mesh, as a texture makes every path dearer."""
    mine = lamps.colour == colour
    shape = quads(lamps.corner[mine], lamps.across[mine], lamps.up[mine], tile=0)
    return _shining(f"lamps{colour}", shape, RADIANCE[colour], 0.5)


def _shining(name: str, shape: Shape, colour: Point, weight: float) -> Mesh:
    shine = {"type": "area", "radiance": rgb(*colour), "sampling_weight": weight}
    black = {"type": "diffuse", "reflectance": rgb(0.05, 0.05, 0.05)}
    return replace(shape.mesh(name, black), emission=shine)


def _drone(index: int, time: float) -> tuple[NDArray[np.float64], Floats]:
    """Where a drone is and how it is turned."""
    phase, period = 1.7 * index, 90 + 17 * index
    angle = 2 * np.pi * time / period + phase
    drift = np.array([1.3 * np.sin(angle), 0.9 * np.cos(angle), 0.35 * np.sin(2 * angle)])
    return np.array(DRONES[index]) + drift, yaw(2 * angle)


def _lamps(time: float) -> Lamps:
    drones = [_drone_lamps(index, time) for index in range(len(DRONES))]
    return joined([fixed(np.random.default_rng(5)), *drones])


def _drone_lamps(index: int, time: float) -> Lamps:
    """Four lamps below a drone, facing down."""
    at, turn = _drone(index, time)
    local = np.array([(x, y, -0.06) for x in (-0.45, 0.33) for y in (-0.06, 0.06)])
    corner = local @ turn.T + at
    one = np.ones((4, 1))
    across, up = turn @ np.array([0, 0.1, 0]), turn @ np.array([0.12, 0, 0])
    colour = (WHITE, CYAN, AMBER, ROSE)[index]
    return Lamps(corner, one * across, one * up, np.full(4, colour))

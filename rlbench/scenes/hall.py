"""Hall: a dark sci-fi hall lit by a thousand small coloured lamps, with metal, crates and drones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.shapes import (
    Floats,
    Shape,
    ball,
    boxes,
    cylinder,
    lathe,
    merge,
    placed,
    quads,
    rotation,
    yaw,
)
from rlbench.scenes.textures import bitmap, glossy, metal, mix, noise, palette, rgb, tiles

WIDTH, LENGTH, HEIGHT = 7.0, 34.0, 7.0  # half width; metres
CYAN, AMBER, ROSE, WHITE = (
    (0.12, 0.75, 1.0),
    (1.0, 0.42, 0.06),
    (1.0, 0.08, 0.35),
    (0.85, 0.92, 1.0),
)
ATLAS = 32  # lamps along a side of the light atlas: one texel a lamp
DRONES = ((-2.2, 9.0, 2.6), (2.4, 13.0, 3.4), (0.2, 19.0, 2.2), (-3.4, 15.0, 4.6))


class Lamps(NamedTuple):
    """Flat rectangles that shine to the side of across x up."""

    corner: NDArray[np.float64]  # n 3
    across: NDArray[np.float64]  # n 3
    up: NDArray[np.float64]  # n 3
    radiance: NDArray[np.float64]  # n 3


def scene() -> Scene:
    """The hall; a thousand lamps are one mesh whose texture holds one radiance a texel."""
    random = np.random.default_rng(23)
    return Scene(
        name="hall",
        title="Hall: a thousand small lamps",
        meshes=(*_building(random), _crates(random), *_movers(0.0)),
        camera=_camera,
        moving=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=5.0,
    )


def _camera(time: float) -> Camera:
    glide = np.sin(2 * np.pi * time / 200)
    x, y = -1.6 + 1.8 * np.sin(2 * np.pi * time / 160), 1.2 + 3.2 * glide
    return Camera((x, y, 1.7), (0.8 + 1.2 * glide, y + 11, 2.5), fov=70)


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
        _mesh("floor", floor, metal(bitmap(plates), 0.2)),
        _mesh("shell", shell, glossy(bitmap(panels), 0.25)),
        _mesh("ribs", _ribs(), metal(rgb(0.42, 0.43, 0.46), 0.3)),
        _mesh("pipes", _pipes(), metal(rgb(0.60, 0.36, 0.22), 0.22), smooth=True),
    )


def _ribs() -> Shape:
    low, high = [], []
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
    low += [(-2.6, LENGTH - 0.5, 0), (2.0, LENGTH - 0.5, 0), (-2.6, LENGTH - 0.5, 4.4)]
    high += [(-2.0, LENGTH, 5), (2.6, LENGTH, 5), (2.6, LENGTH, 5)]  # a gate
    return boxes(low, high)


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
    return _mesh("crates", shape, glossy(palette(colours), 0.2))


def _crate(random: np.random.Generator) -> tuple[Shape, Shape]:
    """A unit crate in one of three colours with dark edges."""
    from rlbench.scenes.shapes import painted

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
    lamps = _lamps(time)
    cell = np.arange(len(lamps.corner))
    rectangles = quads(lamps.corner, lamps.across, lamps.up, tile=0)
    uv = (
        rectangles.uv.reshape(-1, 4, 2) + np.stack([cell % ATLAS, cell // ATLAS], -1)[:, None]
    ) / ATLAS
    radiance = np.zeros((ATLAS * ATLAS, 3), np.float32)
    radiance[cell] = lamps.radiance
    glow = bitmap(radiance.reshape(ATLAS, ATLAS, 3), "nearest") | {"wrap_mode": "clamp"}
    shine = {"type": "area", "radiance": glow}
    black = {"type": "diffuse", "reflectance": rgb(0.05, 0.05, 0.05)}
    return (
        _mesh("drones", drones, metal(rgb(0.75, 0.76, 0.80), 0.12), smooth=True),
        Mesh(
            "lamps",
            rectangles.vertices,
            rectangles.faces,
            black,
            uv=uv.reshape(-1, 2).astype(np.float32),
            emission=shine,
        ),
    )


def _drone(index: int, time: float) -> tuple[NDArray[np.float64], Floats]:
    """Where a drone is and how it is turned."""
    phase, period = 1.7 * index, 90 + 17 * index
    angle = 2 * np.pi * time / period + phase
    drift = np.array([1.3 * np.sin(angle), 0.9 * np.cos(angle), 0.35 * np.sin(2 * angle)])
    return np.array(DRONES[index]) + drift, yaw(2 * angle)


def _lamps(time: float) -> Lamps:
    random = np.random.default_rng(5)
    groups = [_strips(random), _ceiling(random), _signs(random), _gate()]
    groups += [_drone_lamps(index, time) for index in range(len(DRONES))]
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def _strips(random: np.random.Generator) -> Lamps:
    """Two broken lines of small lamps along each long wall, cyan below and rose above."""
    y = np.arange(-3.5, LENGTH - 0.5, 0.3)
    groups = []
    for side in (-1.0, 1.0):
        for height, colour, power in ((0.95, CYAN, 9.0), (3.2, ROSE if side < 0 else AMBER, 7.0)):
            keep = y[random.random(len(y)) < 0.85]
            depth = WIDTH - (1.11 if height < 1 else 0.91)
            x = np.full_like(keep, side * depth)
            corner = np.stack([x, keep + (0.22 if side > 0 else 0), np.full_like(keep, height)], -1)
            across = np.array([[0, -0.22 * side, 0]]).repeat(len(keep), 0)
            up = np.array([[0, 0, 0.07]]).repeat(len(keep), 0)
            shade = random.uniform(0.4, 1.6, (len(keep), 1))
            groups.append(Lamps(corner, across, up, power * shade * np.array(colour)))
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def _ceiling(random: np.random.Generator) -> Lamps:
    """White panels between the beams, many of them dead."""
    spots = [(x, y) for y in np.arange(3.0, LENGTH, 4.0) for x in (-2.4, 0.0, 2.4)]
    at = np.array([(x, y, HEIGHT - 0.65) for x, y in spots])
    shade = np.where(random.random(len(at)) < 0.6, 1.0, 0.08)[:, None]
    one = np.ones((len(at), 1))
    return Lamps(
        at - (0.35, 0.08, 0), one * (0, 0.16, 0), one * (0.7, 0, 0), 8 * shade * np.array(WHITE)
    )


def _signs(random: np.random.Generator) -> Lamps:
    """Panels of tiny lamps on the walls, like consoles and signs, in random colours."""
    groups = []
    for number, y in enumerate(np.arange(3.0, 27.0, 4.0)):
        side = 1.0 if number % 2 else -1.0
        rows, columns = np.meshgrid(np.arange(6), np.arange(12), indexing="ij")
        z = 1.5 + 0.2 * rows.ravel()
        along = y - 1.2 + 0.2 * columns.ravel() + (0.16 if side > 0 else 0)
        corner = np.stack([np.full_like(z, side * (WIDTH - 0.02)), along, z], -1)
        one = np.ones((len(z), 1))
        colour = np.array([CYAN, AMBER, ROSE, WHITE])[random.integers(4, size=len(z))]
        shade = random.choice([0.0, 1.0, 3.0, 8.0], (len(z), 1))
        groups.append(Lamps(corner, one * (0, -0.16 * side, 0), one * (0, 0, 0.14), shade * colour))
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def _gate() -> Lamps:
    """A bright rim about the gate at the far end."""
    z = np.arange(0.3, 4.3, 0.4)
    left = np.stack([np.full_like(z, -1.98), np.full_like(z, LENGTH - 0.52), z], -1)
    right = left + (3.84, 0, 0)
    x = np.arange(-1.9, 1.9, 0.4)
    top = np.stack([x, np.full_like(x, LENGTH - 0.52), np.full_like(x, 4.26)], -1)
    corner = np.concatenate([left, right, top])
    one = np.ones((len(corner), 1))
    across = one * (0.12, 0, 0)
    across[len(z) * 2 :] = (0.34, 0, 0)
    up = one * (0, 0, 0.34)
    up[len(z) * 2 :] = (0, 0, 0.12)
    return Lamps(corner, across, up, one * 20 * np.array(AMBER))


def _drone_lamps(index: int, time: float) -> Lamps:
    """Four lamps below a drone, facing down."""
    at, turn = _drone(index, time)
    local = np.array([(x, y, -0.06) for x in (-0.45, 0.33) for y in (-0.06, 0.06)])
    corner = local @ turn.T + at
    one = np.ones((4, 1))
    across, up = turn @ np.array([0, 0.1, 0]), turn @ np.array([0.12, 0, 0])
    colour = np.array((WHITE, CYAN, AMBER, ROSE)[index])
    return Lamps(corner, one * across, one * up, one * 60 * colour)


def _mesh(name: str, shape: Shape, material: dict[str, object], smooth: bool = False) -> Mesh:
    return Mesh(name, shape.vertices, shape.faces, material, uv=shape.uv, smooth=smooth)

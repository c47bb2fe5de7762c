"""City: a square of house fronts, swaying trees and a car that circles a fountain, in the sun."""

from __future__ import annotations

from functools import cache

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.car import BODY, car
from rlbench.scenes.houses import BAY, PAINTS, house
from rlbench.scenes.shapes import (
    Floats,
    Shape,
    ball,
    boxes,
    disc,
    lathe,
    leaves,
    merge,
    painted,
    placed,
    quads,
    rotation,
    yaw,
)
from rlbench.scenes.takes import cut, static
from rlbench.scenes.textures import bitmap, diffuse, glossy, metal, mix, noise, palette, rgb, tiles

HALF = 15.0  # metres from the fountain to the facades
ORBIT = 6.6  # metres from the fountain to the car
TREES = ((-7.4, -3.5), (-10.0, 4.5), (9.6, -0.5), (10.4, 7.5), (-4.0, 10.5))
GREENS = ((0.10, 0.25, 0.03), (0.17, 0.33, 0.05), (0.08, 0.20, 0.05), (0.30, 0.36, 0.06))
FLAGS = ((0.75, 0.10, 0.06), (0.85, 0.58, 0.08), (0.08, 0.30, 0.55), (0.80, 0.78, 0.72))


def scene() -> Scene:
    """The square on a clear afternoon."""
    random = np.random.default_rng(7)
    return Scene(
        name="city",
        title="City: a square with trees in the sun",
        meshes=(*_ground(random), *_houses(random), *_fountain(), *_movers(0.0)),
        camera=_camera,
        sky=(
            {
                "type": "sunsky",
                "turbidity": 3.5,
                "sun_direction": [-0.62, -0.42, 0.66],
                "sun_scale": 1.0,
                "sky_scale": 1.0,
            },
        ),
        moving=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=5.0,
        takes=(static(_camera, 40.0), cut(_camera, _balcony, "sky0", 1.0, 0.3)),  # a cloud
    )


def _camera(time: float) -> Camera:
    angle = 0.32 * np.sin(2 * np.pi * time / 125) - 0.16
    origin = (15.0 * np.sin(angle), -14.0 * np.cos(angle), 2.7 + 0.25 * np.sin(time / 30))
    return Camera(origin, (0.6 + 1.2 * np.sin(time / 27), 3.0, 4.3), fov=66)


def _balcony(time: float) -> Camera:
    """From above, at a corner of the square, moving along it."""
    return Camera((-12.0 + 0.08 * time, -11.5, 8.0), (1.5, 2.0 + 0.05 * time, 2.0), fov=66)


def _ground(random: np.random.Generator) -> tuple[Mesh, ...]:
    cobbles = tiles(
        random,
        [(0.36, 0.32, 0.28), (0.30, 0.28, 0.26), (0.42, 0.37, 0.31)],
        (0.13, 0.12, 0.10),
        (10, 8),
        bond=0.5,
        gap=0.12,
    )
    plaza = quads((-60, -60, 0), (120, 0, 0), (0, 120, 0), tile=2.6)
    asphalt = mix((0.07, 0.07, 0.075), (0.12, 0.12, 0.12), noise(random, 128, 0.2))
    ring = lathe([(ORBIT + 1.6, 0.02), (ORBIT - 1.6, 0.02)], 96)
    return (
        plaza.mesh("cobbles", diffuse(bitmap(cobbles))),
        ring.mesh("road", glossy(bitmap(asphalt), 0.3)),
    )


def _houses(random: np.random.Generator) -> tuple[Mesh, ...]:
    """Three sides of houses; each part of a house goes to the mesh of its material."""
    rows = [
        ((-HALF, HALF), 0.0, ((5, 4, "brick"), (4, 5, "ochre"), (4, 4, "stone"))),
        ((-HALF, -HALF), np.pi / 2, ((4, 4, "ochre"), (5, 5, "stone"), (4, 4, "brick"))),
        ((HALF, HALF), -np.pi / 2, ((4, 5, "stone"), (5, 4, "ochre"), (4, 4, "brick"))),
    ]
    parts: dict[str, list[Shape]] = {}
    for corner, turn, houses in rows:
        at = np.zeros(3)
        for bays, floors, wall in houses:
            for name, shape in house(random, bays, floors).items():
                shifted = placed(placed(shape, at), (*corner, 0), yaw(turn))
                parts.setdefault(wall if name == "wall" else name, []).append(shifted)
            at = at + (bays * BAY, 0, 0)
    grain = noise(random, 256, 0.6)
    plaster = mix((0.62, 0.38, 0.17), (0.72, 0.50, 0.26), grain)
    brick = tiles(
        random,
        [(0.42, 0.15, 0.09), (0.36, 0.12, 0.08), (0.48, 0.20, 0.12)],
        (0.45, 0.40, 0.34),
        (16, 6),
        0.5,
        gap=0.14,
    )
    ashlar = tiles(
        random, [(0.60, 0.56, 0.48), (0.66, 0.61, 0.52)], (0.36, 0.33, 0.28), (6, 3), 0.5, gap=0.05
    )
    materials = {
        "ochre": diffuse(bitmap(plaster)),
        "brick": diffuse(bitmap(brick)),
        "stone": diffuse(bitmap(ashlar)),
        "trim": diffuse(bitmap(mix((0.60, 0.56, 0.48), (0.72, 0.68, 0.60), grain))),
        "glass": {
            "type": "roughplastic",
            "alpha": 0.05,
            "diffuse_reflectance": rgb(0.015, 0.02, 0.025),
            "int_ior": 1.9,
        },
        "paint": diffuse(palette(PAINTS)),
    }
    parts["paint"] += [_trunk(x, y) for x, y in TREES] + _lanterns()
    return tuple(merge(*parts[name]).mesh(name, material) for name, material in materials.items())


def _trunk(x: float, y: float) -> Shape:
    bark = lathe([(0.30, 0), (0.20, 0.5), (0.17, 2.2), (0.12, 4.4)], 10)
    boughs = [
        placed(
            lathe([(0.10, 0), (0.04, 2.2)], 6),
            (0, 0, 2.4 + 0.3 * k),
            rotation((np.cos(a), np.sin(a), 0), 0.7),
        )
        for k, a in enumerate((0.3, 2.4, 4.5))
    ]
    return painted(placed(merge(bark, *boughs), (x, y, 0)), 4, len(PAINTS))


def _lanterns() -> list[Shape]:
    post = merge(
        lathe([(0.16, 0), (0.08, 0.5), (0.05, 0.7), (0.05, 3.6)], 12),
        boxes((-0.45, -0.03, 3.5), (0.45, 0.03, 3.56)),
        lathe([(0.10, 3.6), (0.22, 4.1), (0.02, 4.35)], 6),
    )
    seat = boxes(
        [(-0.9, 0, 0.4), (-0.9, 0.42, 0.55), (-0.8, 0, 0)],
        [(0.9, 0.4, 0.46), (0.9, 0.48, 0.95), (-0.7, 0.4, 0.4)],
    )
    spots = [(-8.6, -7.0), (5.2, -8.6), (11.8, 3.4), (-11.9, 0.4)]
    lanterns = [painted(placed(post, (x, y, 0)), 8, len(PAINTS)) for x, y in spots]
    return lanterns + [
        painted(placed(seat, (x + 1.6, y, 0), yaw(0.1 * x)), 4, len(PAINTS)) for x, y in spots
    ]


def _fountain() -> tuple[Mesh, ...]:
    rim = lathe([(3.1, 0), (3.1, 0.5), (3.3, 0.55), (3.3, 0.75), (2.8, 0.75), (2.8, 0.2)], 64)
    stem = lathe(
        [(0.7, 0.1), (0.35, 0.5), (0.3, 1.3), (1.3, 1.75), (1.35, 1.9), (0.3, 1.8), (0.25, 2.7)], 40
    )
    stone = bitmap(np.full((1, 1, 3), (0.62, 0.58, 0.52), np.float32))
    water = merge(disc(2.85, 0.62, 48), disc(1.3, 1.88, 40))
    return (
        merge(rim, stem).mesh("fountain", diffuse(stone), smooth=False),
        water.mesh(
            "pool",
            {
                "type": "roughplastic",
                "diffuse_reflectance": rgb(0.03, 0.09, 0.09),
                "int_ior": 1.33,
                "alpha": 0.05,
            },
        ),
        placed(ball(4), (0, 0, 3.25), scale=0.62).mesh(
            "globe", metal(rgb(1.0, 0.78, 0.36), 0.12), smooth=True
        ),
    )


def _movers(time: float) -> tuple[Mesh, ...]:
    """The leaves and flags in the wind, and the car."""
    return (_foliage(time), _car(time))


def _foliage(time: float) -> Mesh:
    rest, softness = _foliage_at_rest()
    wind = 2 * np.pi * time / 46 + 0.35 * rest.vertices[:, 0] + 0.2 * rest.vertices[:, 1]
    flutter = 2 * np.pi * time / 11 + 12.9 * rest.vertices[:, 0] + 7.3 * rest.vertices[:, 2]
    push = softness * (0.16 * np.sin(wind) + 0.03 * np.sin(flutter))
    shift = push[:, None] * np.array([0.8, 0.5, -0.25])
    vertices = (rest.vertices + shift).astype(np.float32)
    thin = {
        "type": "principledthin",
        "base_color": palette(GREENS + FLAGS),
        "roughness": 0.6,
        "diff_trans": 0.8,
    }
    return Mesh("foliage", vertices, rest.faces, thin, uv=rest.uv)


@cache
def _foliage_at_rest() -> tuple[Shape, Floats]:
    """Leaves and flags without wind, and for each vertex how far the wind may push it, 0..1."""
    random = np.random.default_rng(3)
    of = len(GREENS + FLAGS)
    crowns = []
    for x, y in TREES:
        puffs = np.array([x, y, 5.2]) + random.normal(size=(9, 3)) * (0.95, 0.95, 0.75)
        centres = puffs[random.integers(len(puffs), size=2600)]
        crown = leaves(random, centres, 1.05, 0.2)
        crowns.append(painted(crown, random.choice(4, 2600, p=[0.4, 0.3, 0.2, 0.1]).repeat(4), of))
    green = merge(*crowns)
    flags = [
        _bunting(a, b) for a, b in (((-14, 2, 9), (13, 14, 10)), ((-13, 13, 10.5), (14, 1, 9)))
    ]
    rest = merge(green, *flags)
    soft = np.concatenate(
        [
            np.clip((green.vertices[:, 2] - 2) / 4, 0.2, 1),
            *(np.tile([0.2, 0.2, 2.0, 2.0], len(flag.vertices) // 4) for flag in flags),
        ]
    )
    return rest, soft.astype(np.float32)


def _bunting(start: tuple[float, float, float], end: tuple[float, float, float]) -> Shape:
    """A sagging line of flags, each a quad that hangs from its first two corners."""
    share = np.linspace(0, 1, 40)[:, None]
    line = np.array(start) * (1 - share) + np.array(end) * share
    line[:, 2] -= 4 * 1.8 * share[:, 0] * (1 - share[:, 0])
    across = np.diff(line, axis=0) * 0.75
    flags = quads(line[:-1], across, (0.0, 0.0, -0.55))
    slots = len(GREENS) + np.arange(len(across)) % len(FLAGS)
    return painted(flags, slots.repeat(4), len(GREENS + FLAGS))


def _car(time: float) -> Mesh:
    """The car at a time, on its circle about the fountain."""
    angle = 2 * np.pi * time / 190 - 1.95
    at = (ORBIT * np.cos(angle), ORBIT * np.sin(angle), 0.0)
    shape = placed(car(), at, yaw(angle + np.pi / 2))
    coat = glossy(palette(BODY), 0.06)
    return shape.mesh("car", coat)

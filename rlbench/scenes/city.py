"""City: a square of facades, trees with swaying leaves and a car that circles a fountain, in sun."""

from __future__ import annotations

from functools import cache

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.shapes import (
    Floats,
    Shape,
    ball,
    boxes,
    cylinder,
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
from rlbench.scenes.textures import bitmap, diffuse, glossy, metal, mix, noise, palette, rgb, tiles

HALF = 15.0  # metres from the fountain to the facades
FLOOR, BAY = 3.1, 2.4  # metres: height of a storey, width of a window bay
ORBIT = 6.6  # metres from the fountain to the car
TREES = ((-7.4, -3.5), (-10.0, 4.5), (9.6, -0.5), (10.4, 7.5), (-4.0, 10.5))
PAINTS = (
    (0.06, 0.16, 0.12),  # 0 shutters
    (0.05, 0.10, 0.22),
    (0.30, 0.05, 0.04),
    (0.045, 0.05, 0.06),  # 3 slate
    (0.14, 0.08, 0.05),  # 4 bark and wood
    (0.65, 0.09, 0.07),  # 5 awnings
    (0.78, 0.74, 0.66),
    (0.08, 0.26, 0.30),
    (0.025, 0.03, 0.03),  # 8 iron
)
GREENS = ((0.10, 0.25, 0.03), (0.17, 0.33, 0.05), (0.08, 0.20, 0.05), (0.30, 0.36, 0.06))
FLAGS = ((0.75, 0.10, 0.06), (0.85, 0.58, 0.08), (0.08, 0.30, 0.55), (0.80, 0.78, 0.72))
BODY = ((0.50, 0.03, 0.03), (0.015, 0.02, 0.025), (0.02, 0.02, 0.02), (0.70, 0.68, 0.60))


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
    )


def _camera(time: float) -> Camera:
    angle = 0.32 * np.sin(2 * np.pi * time / 170) - 0.16
    origin = (15.0 * np.sin(angle), -14.0 * np.cos(angle), 2.7 + 0.25 * np.sin(time / 30))
    return Camera(origin, (0.6 + 1.2 * np.sin(time / 37), 3.0, 4.3), fov=66)


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
        _mesh("cobbles", plaza, diffuse(bitmap(cobbles))),
        _mesh("road", ring, glossy(bitmap(asphalt), 0.3)),
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
            for name, shape in _house(random, bays, floors).items():
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
            "type": "plastic",
            "diffuse_reflectance": rgb(0.015, 0.02, 0.025),
            "int_ior": 1.9,
        },
        "paint": diffuse(palette(PAINTS)),
    }
    parts["paint"] += [_trunk(x, y) for x, y in TREES] + _lanterns()
    return tuple(_mesh(name, merge(*parts[name]), material) for name, material in materials.items())


def _house(random: np.random.Generator, bays: int, floors: int) -> dict[str, Shape]:
    """A house front from x = 0 that faces -y: shop, storeys of windows, cornice and slate roof."""
    width, shop, depth = bays * BAY, 3.9, 0.32
    top = shop + floors * FLOOR
    middles = BAY * (np.arange(bays) + 0.5)
    x, z = (grid.ravel() for grid in np.meshgrid(middles, shop + FLOOR * np.arange(floors)))
    half = 0.55  # of a window, metres
    level, wall_z = np.zeros_like(x), np.zeros(bays + 1)

    edges = np.concatenate([[0.0], middles + half]), np.concatenate([middles - half, [width]])
    piers = boxes(
        np.stack([edges[0], wall_z, wall_z + shop], -1),
        np.stack([edges[1], wall_z + depth, wall_z + top], -1),
        tile=2.0,
    )
    sill, head = z + 0.75, z + 2.55
    below = boxes(
        np.stack([x - half, level, z], -1), np.stack([x + half, level + depth, sill], -1), tile=2.0
    )
    above = boxes(
        np.stack([x - half, level, head], -1),
        np.stack([x + half, level + depth, z + FLOOR], -1),
        tile=2.0,
    )
    body = boxes((0, depth + 0.1, 0), (width, 9, top), tile=2.0)

    sills = boxes(
        np.stack([x - 0.72, level - 0.14, sill - 0.1], -1),
        np.stack([x + 0.72, level + depth, sill], -1),
    )
    bars = boxes(
        np.stack([x - 0.03, level + 0.2, sill], -1), np.stack([x + 0.03, level + 0.3, head], -1)
    )
    bands = boxes(
        [(0, -0.1, shop - 0.35), (0, -0.45, top - 0.1), (0, -0.25, top - 0.4)],
        [(width, 0.35, shop), (width, depth, top + 0.25), (width, depth, top)],
    )
    posts = boxes(
        np.stack([BAY * np.arange(bays + 1) - 0.18, wall_z - 0.05, wall_z], -1).clip(
            (0, -9, 0), None
        ),
        np.stack([BAY * np.arange(bays + 1) + 0.18, wall_z + 0.3, wall_z + shop], -1).clip(
            None, (width, 9, 99)
        ),
    )
    glass = quads((0, depth - 0.04, 0), (width, 0, 0), (0, 0, top))
    return {
        "wall": merge(piers, below, above, body),
        "trim": merge(sills, bars, bands, posts),
        "glass": glass,
        "paint": merge(*_dressing(random, x, sill, head, width, top)),
    }


def _dressing(
    random: np.random.Generator, x: Floats, sill: Floats, head: Floats, width: float, top: float
) -> list[Shape]:
    """Shutters, an awning above each shop window, the roof and its chimneys."""
    shut = random.integers(3)
    of = len(PAINTS)
    left = np.stack([x - 1.05, np.full_like(x, -0.07), sill], -1)
    leaf = np.stack([np.full_like(x, 0.48), np.full_like(x, 0.06), head - sill], -1)
    shutters = boxes(
        np.concatenate([left, left + (1.62, 0, 0)]),
        np.concatenate([left + leaf, left + leaf + (1.62, 0, 0)]),
    )
    stripes = np.arange(0.3, width - 0.5, 0.3)
    corner = np.stack([stripes, np.full_like(stripes, -1.3), np.full_like(stripes, 2.6)], -1)
    awning = quads(corner, (0.3, 0, 0), (0, 1.3, 0.75))
    colour = np.where(np.arange(len(stripes)) % 2, 6, random.choice([5, 7])).repeat(4)
    roof = quads((0, -0.3, top + 0.25), (width, 0, 0), (0, 1.9, 2.8))
    pots = random.uniform(0.8, width - 1.2, 3)
    low = np.stack([pots, np.full(3, 1.6), np.full(3, top)], -1)
    return [
        painted(shutters, shut, of),
        painted(awning, colour, of),
        painted(roof, 3, of),
        painted(boxes(low, low + (0.8, 0.6, 3.6)), 2, of),
    ]


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
    spots = [(-4.4, -9.2), (5.2, -8.6), (11.8, 3.4), (-11.9, 0.4)]
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
        _mesh("fountain", merge(rim, stem), diffuse(stone), smooth=False),
        _mesh(
            "pool",
            water,
            {"type": "plastic", "diffuse_reflectance": rgb(0.03, 0.09, 0.09), "int_ior": 1.33},
        ),
        _mesh(
            "globe",
            placed(ball(4), (0, 0, 3.25), scale=0.62),
            metal(rgb(1.0, 0.78, 0.36), 0.08),
            smooth=True,
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
    shape = placed(_car_at_origin(), at, yaw(angle + np.pi / 2))
    coat = {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": palette(BODY)}}
    return _mesh("car", shape, coat)


@cache
def _car_at_origin() -> Shape:
    """A small old car that drives towards +x."""
    hull = [(-2.0, 0.35), (2.05, 0.35), (2.1, 0.75), (1.9, 0.95), (0.95, 1.05), (0.45, 1.62)]
    hull += [(-1.05, 1.66), (-1.75, 1.05), (-2.1, 0.95)]
    pane = [(0.80, 1.07), (0.42, 1.52), (-0.25, 1.55), (-0.25, 1.07)]
    rear = [(-0.35, 1.07), (-0.35, 1.55), (-1.0, 1.55), (-1.5, 1.07)]
    of = len(BODY)
    parts = [painted(_extruded(hull, 0.85), 0, of)]
    parts += [painted(_extruded(window, 0.86), 1, of) for window in (pane, rear)]
    parts += [painted(quads((0.99, -0.7, 1.1), (0, 1.4, 0), (-0.46, 0, 0.5)), 1, of)]
    parts += [painted(quads((-1.70, 0.7, 1.15), (0, -1.4, 0), (0.56, 0, 0.48)), 1, of)]
    on_axle = rotation((1, 0, 0), np.pi / 2)
    for x in (-1.3, 1.35):
        for y in (-0.72, 0.9):
            parts.append(painted(placed(cylinder(0.36, 0, 0.2, 20), (x, y, 0.36), on_axle), 2, of))
            parts.append(
                painted(placed(cylinder(0.2, -0.01, 0.21, 16), (x, y, 0.36), on_axle), 3, of)
            )
    parts.append(
        painted(
            boxes(
                [(2.05, -0.85, 0.4), (-2.15, -0.85, 0.4)], [(2.2, 0.85, 0.52), (-2.0, 0.85, 0.52)]
            ),
            3,
            of,
        )
    )
    return merge(*parts)


def _extruded(outline: list[tuple[float, float]], half: float) -> Shape:
    """A convex outline in (x, z), counter-clockwise seen from -y, made 2 x half wide."""
    flat = np.array(outline)
    near = np.stack([flat[:, 0], np.full(len(flat), -half), flat[:, 1]], -1)
    sides = quads(near, np.roll(near, -1, 0) - near, (0, 2 * half, 0))
    sides = sides._replace(faces=sides.faces[:, ::-1])
    fan = np.array([(0, k, k + 1) for k in range(1, len(flat) - 1)], np.uint32)
    uv = np.zeros((len(flat), 2), np.float32)
    lid = Shape(near.astype(np.float32), fan, uv)
    other = Shape((near * (1, -1, 1)).astype(np.float32), fan[:, ::-1], uv)
    return merge(sides, lid, other)


def _mesh(name: str, shape: Shape, material: dict[str, object], smooth: bool = False) -> Mesh:
    return Mesh(name, shape.vertices, shape.faces, material, uv=shape.uv, smooth=smooth)

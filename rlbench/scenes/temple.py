"""Temple: a hall of columns lit by the sun through slits and by panes of glowing alabaster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.shapes import (
    Floats,
    Shape,
    ball,
    boxes,
    column,
    cylinder,
    lathe,
    merge,
    placed,
    quads,
    rotation,
)
from rlbench.scenes.takes import cut, static, still
from rlbench.scenes.textures import bitmap, diffuse, glossy, metal, mix, noise, rgb, tiles

WIDTH, LENGTH, HEIGHT, THICK = 6.0, 30.0, 9.0, 0.5  # half width; metres; THICK: of walls
Point = tuple[float, float, float]

BAYS = np.arange(3.0, 28.0, 4.0)  # where the columns stand, along the hall
SLITS, HALF_SLIT = (BAYS[:-1] + BAYS[1:]) / 2, 0.85  # in the middle of each bay; metres
TRANSOM = 4.6  # metres: above it, the slits of the sunny side are glazed
GLOW = (1.6, 1.32, 0.96)  # radiance of alabaster in the sun
DAY = (1.0, 1.25, 1.6)  # radiance of the sky through the door
PIVOT = np.array([0.3, 12.0, HEIGHT])  # where the lamp hangs from


def scene() -> Scene:
    """The hall, its swinging brass lamp and a crystal orb that floats above the altar."""
    random = np.random.default_rng(11)
    return Scene(
        name="temple",
        title="Temple: columns, sun and alabaster",
        meshes=(*_building(random), *_furniture(random), *_panes(), *_movers()),
        camera=_camera,
        sky=(
            {"type": "constant", "radiance": rgb(0.75, 0.95, 1.2), "sampling_weight": 0.04},
            {
                "type": "directional",
                "direction": [-0.78, 0.22, -0.6],
                "sampling_weight": 1.1,
                "irradiance": rgb(11.5, 9.8, 7.1),
            },
        ),
        moving=_moving,
        exposure=0.95,
        depth=4,
        takes=(
            static(_below_lamp, 0.0),
            cut(_camera, _from_altar, "sky1", 1.0, 0.05),  # the sun goes
            still(_camera, 55.0),
        ),
    )


def _camera(time: float) -> Camera:
    sway = np.sin(2 * np.pi * time / 105)
    y = 1.6 + 3.0 * np.sin(2 * np.pi * time / 170)
    x = 0.9 + 0.9 * sway
    return Camera((x, y, 1.9), (-0.9 + 1.2 * sway, y + 12, 3.1), fov=68)


def _below_lamp(time: float) -> Camera:
    """Near the swinging lamp, which moves little in the picture from elsewhere."""
    return Camera((1.2, 8.4, 2.0), (-0.2, 14.0, 3.4), fov=68)


def _from_altar(time: float) -> Camera:
    """Back towards the door, moving across the hall."""
    x = 2.0 - 0.06 * time
    return Camera((x, 23.5, 2.6), (x - 2.2, 8.0, 3.0), fov=68)


def _moving(time: float) -> dict[str, Floats]:
    return {mesh.name: mesh.vertices for mesh in _movers(time)}


def _building(random: np.random.Generator) -> tuple[Mesh, ...]:
    stone = mix((0.50, 0.43, 0.34), (0.70, 0.63, 0.52), noise(random, 256, 0.5))
    ashlar = tiles(
        random,
        [(0.58, 0.50, 0.39), (0.64, 0.56, 0.45), (0.54, 0.45, 0.35)],
        (0.30, 0.25, 0.20),
        count=(6, 3),
        bond=0.5,
        gap=0.04,
    )
    marble = tiles(
        random, [(0.55, 0.20, 0.11), (0.66, 0.54, 0.38)], (0.16, 0.10, 0.07), (4, 4), gap=0.03
    )
    return (
        merge(_wall(1.0), _wall(-1.0), _ends()).mesh("walls", diffuse(bitmap(ashlar))),
        _columns().mesh("columns", diffuse(bitmap(stone)), smooth=True),
        _ceiling().mesh(
            "ceiling",
            diffuse(bitmap(mix((0.34, 0.20, 0.11), (0.46, 0.29, 0.17), noise(random, 128)))),
        ),
        _floor().mesh("floor", glossy(bitmap(marble), 0.12)),
    )


def _wall(side: float) -> Shape:
    """One long wall with a slit in the middle of each bay."""
    x0, x1 = sorted((side * WIDTH, side * (WIDTH + THICK)))
    starts = np.concatenate([[-4.0], SLITS + HALF_SLIT])
    ends = np.concatenate([SLITS - HALF_SLIT, [LENGTH]])
    low, high = (1.6, 7.8) if side > 0 else (3.4, 7.8)
    column_of = np.ones_like(starts)
    piers = boxes(
        np.stack([x0 * column_of, starts, low * column_of], -1),
        np.stack([x1 * column_of, ends, high * column_of], -1),
        tile=3.0,
    )
    below = boxes((x0, -4, 0), (x1, LENGTH, low), tile=3.0)
    above = boxes((x0, -4, high), (x1, LENGTH, HEIGHT + 0.5), tile=3.0)
    return merge(piers, below, above)


def _panes() -> tuple[Mesh, ...]:
    """Alabaster that shines in the slits, and the open door behind the viewer."""
    y = SLITS.repeat(2)
    side = np.tile([-1.0, 1.0], len(SLITS))
    low = np.where(side < 0, 3.4, TRANSOM)
    corner = np.stack([side * (WIDTH + 0.2), y + side * HALF_SLIT, low], -1)
    across = np.stack([0 * y, -2 * side * HALF_SLIT, 0 * y], -1)
    up = np.stack([0 * y, 0 * y, 7.8 - low], -1)
    door = quads((3, -3.98, 0.5), (-6, 0, 0), (0, 0, 6))
    return (
        _shining("panes", quads(corner, across, up), GLOW, 1.0),
        _shining("door", door, DAY, 0.35),
    )


def _shining(name: str, shape: Shape, colour: Point, weight: float) -> Mesh:
    shine = {"type": "area", "radiance": rgb(*colour), "sampling_weight": weight}
    return replace(
        shape.mesh(name, {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)}), emission=shine
    )


def _ends() -> Shape:
    back = boxes((-WIDTH - THICK, -4.7, 0), (WIDTH + THICK, -4, HEIGHT + 0.5), tile=3.0)
    niche = boxes(
        [(-WIDTH - THICK, LENGTH, 0), (2.2, LENGTH, 0), (-2.2, LENGTH, 6), (-2.2, LENGTH + 2, 0)],
        [
            (-2.2, LENGTH + 2, HEIGHT + 0.5),
            (WIDTH + THICK, LENGTH + 2, HEIGHT + 0.5),
            (2.2, LENGTH + 2, HEIGHT + 0.5),
            (2.2, LENGTH + 2.7, HEIGHT + 0.5),
        ],
        tile=3.0,
    )
    return merge(back, niche)


def _columns() -> Shape:
    one = column(HEIGHT - 0.8, 0.55)
    return merge(*(placed(one, (x, y, 0)) for y in BAYS for x in (-3.3, 3.3)))


def _ceiling() -> Shape:
    slab = boxes((-WIDTH - THICK, -4.7, HEIGHT), (WIDTH + THICK, LENGTH + 2.7, HEIGHT + 0.5))
    beams: list[tuple[Point, Point]] = [
        ((-3.75, -4, HEIGHT - 0.8), (-2.85, LENGTH, HEIGHT)),
        ((2.85, -4, HEIGHT - 0.8), (3.75, LENGTH, HEIGHT)),
    ]
    beams += [((-WIDTH, y - 0.3, HEIGHT - 0.5), (WIDTH, y + 0.3, HEIGHT)) for y in BAYS]
    low, high = zip(*beams, strict=True)
    return merge(slab, boxes(low, high))


def _floor() -> Shape:
    flat = boxes((-WIDTH - THICK, -4.7, -0.4), (WIDTH + THICK, LENGTH + 2.7, 0), tile=4.0)
    steps = [
        boxes((-2.8 + s, 25.4 + s, 0), (2.8 - s, LENGTH, 0.25 + s / 2), tile=4.0)
        for s in (0, 0.5, 1)
    ]
    return merge(flat, *steps)


def _furniture(random: np.random.Generator) -> tuple[Mesh, ...]:
    weave = tiles(
        random, [(0.42, 0.03, 0.03), (0.36, 0.02, 0.04)], (0.55, 0.33, 0.08), (8, 8), gap=0.16
    )
    carpet = boxes((-1.1, -4, 0), (1.1, 25.4, 0.02), tile=2.2)
    disc_of_sun = placed(
        lathe([(1.7, 0.0), (1.7, 0.16), (1.45, 0.22), (0.9, 0.1), (0.5, 0.3), (0.01, 0.42)], 64),
        (0, 31.7, 3.6),
        rotation((1, 0, 0), np.pi / 2),
    )
    vase = lathe([(0.2, 0), (0.42, 0.3), (0.5, 0.7), (0.36, 1.1), (0.2, 1.35), (0.3, 1.55)], 40)
    vases = [
        placed(vase, (x, y, 0)) for x, y in ((-2.1, 7.2), (2.15, 11.3), (-2.15, 19), (4.9, 5.2))
    ]
    return (
        carpet.mesh("carpet", diffuse(bitmap(weave))),
        disc_of_sun.mesh("gold", metal(rgb(0.95, 0.70, 0.32), 0.25), smooth=True),
        merge(*vases).mesh("vases", glossy(rgb(0.05, 0.20, 0.24), 0.08), smooth=True),
    )


def _movers(time: float = 0.0) -> tuple[Mesh, ...]:
    """The brass lamp on its chain and the orb, as they are at a time."""
    swing = rotation((0.25, 1, 0), 0.24 * np.sin(2 * np.pi * time / 70 + 0.4))
    lamp = [cylinder(0.025, -5.2, 0.0, 8), placed(ball(3), (0, 0, -5.55), scale=0.42)]
    lamp += [placed(lathe([(0.56, 0), (0.62, 0.05), (0.56, 0.1)], 40), (0, 0, -5.6))]
    orb = placed(ball(4), (0, 27.6, 2.1 + 0.35 * np.sin(2 * np.pi * time / 60)), scale=0.7)
    return (
        placed(merge(*lamp), PIVOT, swing).mesh(
            "lamp", metal(rgb(0.88, 0.62, 0.30), 0.18), smooth=True
        ),
        orb.mesh("orb", glossy(rgb(0.62, 0.10, 0.05), 0.05), smooth=True),
    )

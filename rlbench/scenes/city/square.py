"""Square: the paving, the house rows, the tower, the fountain and what stands in the street."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlbench.render.scene import Mesh
from rlbench.scenes.city import office, street, trees
from rlbench.scenes.city.car import BODY, car
from rlbench.scenes.city.houses import BAY, PAINTS, house
from rlbench.scenes.city.windows import CELLS, behind, windows
from rlbench.scenes.parts.glassware import faceted
from rlbench.scenes.parts.shapes import (
    Shape,
    ball,
    boxes,
    disc,
    lathe,
    merge,
    painted,
    placed,
    quads,
    yaw,
)
from rlbench.scenes.parts.textures import (
    bitmap,
    diffuse,
    glossy,
    metal,
    mix,
    noise,
    palette,
    rgb,
    tiles,
)

HALF = 15.0  # metres from the fountain to the facades
ORBIT = 6.6  # metres from the fountain to the middle of the road
TOWER = (16.6, 18.4)  # metres: the axis of the office
METALS = ((1.0, 0.78, 0.36), (0.56, 0.57, 0.58), (0.10, 0.11, 0.11))  # gold, aluminium, iron
POSTS = ((-8.9, -1.4), (5.6, -8.6), (8.9, 7.4), (-6.8, 8.2))
TABLES = ((9.2, 0.2), (11.9, 2.1), (9.6, 3.9))
PARKED = ((-11.8, -0.2, 1.5, 2), (-12.0, 4.9, 1.62, 1), (-1.0, 12.2, 0.0, 3), (4.6, 12.3, 3.14, 2))
# x, y, yaw, coat
LOW = ((4, 1, "ochre"), (5, 2, "stone"), (4, 1, "brick"), (6, 2, "ochre"))  # bays, floors, wall
SEATS = ((-9.9, -3.6, 1.9), (-4.6, 9.2, 2.6), (4.2, 9.3, -2.7), (11.6, -3.4, -1.7))
PLANTERS = ((7.4, 5.9), (12.6, 5.2), (8.6, -2.6))


def paving(random: np.random.Generator) -> tuple[Mesh, ...]:
    """Cobbles with paler bands, and the road about the fountain between its kerbs."""
    cobbles = tiles(
        random,
        [(0.33, 0.30, 0.27), (0.27, 0.26, 0.25), (0.38, 0.34, 0.29), (0.30, 0.27, 0.23)],
        (0.12, 0.11, 0.095),
        (30, 24),
        0.5,
        1024,
        gap=0.13,
    )
    stains = 0.72 + 0.45 * noise(random, 1024, 0.8)
    cobbles[:42] = 0.46 * (0.8 + 0.3 * noise(random, 1024, 0.2)[:42])  # a row of pale slabs
    cobbles[42:46] = cobbles[:3].min()
    cobbles = cobbles * stains
    plaza = quads((-60, -60, 0), (120, 0, 0), (0, 120, 0), tile=6.0)
    asphalt = mix((0.055, 0.055, 0.06), (0.115, 0.11, 0.105), noise(random, 256, 0.35))
    ring = lathe([(ORBIT + 1.6, 0.02), (ORBIT - 1.6, 0.02)], 96)
    return (
        plaza.mesh("cobbles", diffuse(bitmap(cobbles))),
        ring.mesh("road", glossy(bitmap(asphalt), 0.28)),
    )


def buildings(random: np.random.Generator, woods: Sequence[trees.Tree]) -> tuple[Mesh, ...]:
    """Rows of houses with the tower, and all static parts that share their materials."""
    rows = [
        ((-HALF - 2.4, HALF), 0.0, ((4, 4, "stone"), (5, 4, "brick"), (4, 5, "ochre"))),
        ((-27.0, -HALF), np.pi / 2, LOW),
        ((HALF + 2, 6.0), -np.pi / 2, ((4, 4, "stone"), (5, 3, "ochre"))),
    ]
    parts: dict[str, list[Shape]] = {}
    for corner, turn, houses in rows:
        at = np.zeros(3)
        for bays, floors, wall in houses:
            for name, shape in house(random, bays, floors).items():
                shifted = placed(placed(shape, at), (*corner, 0), yaw(turn))
                parts.setdefault(wall if name == "wall" else name, []).append(shifted)
            at = at + (bays * BAY, 0, 0)
    of = len(PAINTS)
    tower = office.panes(random, *TOWER)
    desks = CELLS * (CELLS - 2) + random.integers(CELLS, size=len(tower.vertices) // 4)
    parts["glass"].append(behind(tower, desks))
    parts["trim"] += [_fountain(), _kerbs()]
    parts["paint"] += [
        painted(trees.wood(woods), 4, of),
        street.benches(SEATS, 12, 8, of),
        street.terrace(TABLES, (5, 6), 12, 8, of),
        street.planters(random, PLANTERS, 12, (9, 10, 11, 11, 11), of),
    ]
    grain = noise(random, 256, 0.6)
    plaster = mix((0.56, 0.36, 0.18), (0.66, 0.48, 0.28), grain)
    brick = tiles(
        random,
        [(0.34, 0.13, 0.08), (0.28, 0.10, 0.07), (0.40, 0.18, 0.11), (0.30, 0.14, 0.10)],
        (0.40, 0.36, 0.31),
        (26, 9),
        0.5,
        512,
        gap=0.12,
    )
    ashlar = tiles(
        random, [(0.58, 0.54, 0.46), (0.64, 0.59, 0.50)], (0.36, 0.33, 0.28), (5, 3), 0.5, gap=0.04
    )
    pane = {
        "type": "roughplastic",
        "alpha": 0.1,
        "diffuse_reflectance": bitmap(windows(random)),
        "int_ior": 1.8,
    }
    materials = {
        "ochre": diffuse(bitmap(plaster)),
        "brick": diffuse(bitmap(brick)),
        "stone": diffuse(bitmap(ashlar)),
        "trim": diffuse(bitmap(mix((0.56, 0.52, 0.45), (0.68, 0.64, 0.56), grain))),
        "glass": pane,
        "paint": diffuse(palette(PAINTS)),
    }
    return (
        *(merge(*parts[name]).mesh(name, material) for name, material in materials.items()),
        *_bright(),
    )


def _bright() -> tuple[Mesh, ...]:
    """What shines: metal, parked cars and the water of the fountain."""
    of = len(METALS)
    metals = merge(
        painted(placed(ball(4), (0, 0, 3.25), scale=0.62), 0, of),
        painted(faceted(office.frame(*TOWER)), 1, of),
        painted(street.posts(POSTS), 2, of),
        painted(street.bollards(_bollards()), 2, of),
    )
    parked = merge(*(placed(car(coat), (x, y, 0), yaw(turn)) for x, y, turn, coat in PARKED))
    water = merge(disc(2.85, 0.62, 48), disc(1.3, 1.88, 40))
    wet = {
        "type": "roughplastic",
        "diffuse_reflectance": rgb(0.03, 0.08, 0.08),
        "int_ior": 1.33,
        "alpha": 0.05,
    }
    return (
        water.mesh("pool", wet),
        metals.mesh("metal", metal(palette(METALS), 0.18), smooth=True),
        parked.mesh("parked", coating(), smooth=True),
    )


def coating() -> dict[str, object]:
    """The lacquer of cars."""
    return glossy(palette(BODY), 0.09)


def _bollards() -> tuple[tuple[float, float], ...]:
    angle = np.linspace(-2.5, -0.5, 9)
    return tuple((float(8.6 * np.cos(a)), float(8.6 * np.sin(a))) for a in angle)


def _kerbs() -> Shape:
    """Low stone edges on both sides of the road."""
    inner, outer = ORBIT - 1.6, ORBIT + 1.6
    return merge(
        lathe([(outer, 0.0), (outer, 0.1), (outer + 0.14, 0.1), (outer + 0.14, 0.0)][::-1], 96),
        lathe([(inner, 0.0), (inner, 0.1), (inner - 0.14, 0.1), (inner - 0.14, 0.0)], 96),
    )


def _fountain() -> Shape:
    rim = lathe(
        [(3.1, 0), (3.15, 0.08), (3.05, 0.14), (3.05, 0.5), (3.3, 0.58), (3.3, 0.75), (2.8, 0.75)]
        + [(2.8, 0.2)],
        64,
    )
    stem = lathe(
        [(0.8, 0.1), (0.7, 0.3), (0.35, 0.6), (0.28, 1.2), (0.45, 1.45), (1.3, 1.75), (1.4, 1.95)]
        + [(1.3, 1.95), (0.3, 1.8), (0.22, 2.2), (0.3, 2.55), (0.2, 2.7)],
        40,
    )
    return merge(rim, stem, boxes((-0.2, -0.2, 2.55), (0.2, 0.2, 2.7)))

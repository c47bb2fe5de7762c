"""Places for random scenes: rooms, halls with slits, open ground and shallow pools, unlit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.scenes import generator_shapes as shapes
from rlbench.scenes.generator_shapes import Opening, Shape, moved, turn


class Hole(NamedTuple):
    """What the light estimate needs to know of openings in one wall."""

    outward: tuple[float, float, float]
    area: float  # m2


@dataclass(frozen=True)
class Place:
    """A setting without light or objects; x, y in [-half, half], objects stand on `floor`."""

    half: tuple[float, float]  # m
    walk: tuple[float, float]  # the camera keeps to |x|, |y| below this, m
    eye: tuple[float, float]  # camera heights, m
    gaze: tuple[float, float]  # heights that it looks at, m
    top: float  # where lamps hang, m
    shell: dict[str, Shape]  # what is there already, by the material it gets
    taken: tuple[tuple[float, float, float], ...] = ()  # discs x, y, radius that are occupied
    holes: tuple[Hole, ...] = ()
    roof: bool = False
    floor: float = 0.0
    lamp: float = 1.0  # lamps are this much larger than usual
    near: float = 1.4  # objects keep this far from the camera, m


def _room(rng: Generator, kind: str) -> Place:
    half = (rng.uniform(2.0, 3.5), rng.uniform(2.4, 4.5))
    height = rng.uniform(2.4, 3.4)
    big = kind in ("sky", "sun", "sunsky")
    windows = {
        k: _row(rng, 2 * half[k % 2] - 0.4, rng.uniform(0.8, 1.8), 0.4 if big else 1.5, height)
        for k in rng.choice(4, 2 if big else 1, replace=False)
    }
    shell, holes = _walls(half, height, rng.uniform(0.1, 0.35), windows, roof=True)
    walk = (half[0] - 0.35, half[1] - 0.35)
    return Place(half, walk, (1.0, 1.9), (0.4, 1.2), height, shell, holes=holes, roof=True)


def _hall(rng: Generator, kind: str) -> Place:
    half = (rng.uniform(3.5, 6), rng.uniform(7, 12))
    height = rng.uniform(4, 7)
    slits = {k: _row(rng, 2 * half[1] - 1, rng.uniform(0.4, 0.9), 0.7, height) for k in (1, 3)}
    if rng.random() < 0.5 and kind not in ("lamps", "bulbs"):
        slits[4] = _row(rng, 2 * half[0] - 1, rng.uniform(0.3, 0.9), 0.5, 2 * half[1])
    shell, holes = _walls(half, height, rng.uniform(0.3, 0.6), slits, roof=True)
    girth = rng.uniform(0.15, 0.4)
    aisle = half[0] * rng.uniform(0.5, 0.7)
    column = _column(rng, girth, height)
    spots = [
        (side * aisle, y, 1.5 * girth)
        for y in np.arange(-half[1] + 1.2, half[1] - 0.8, rng.uniform(1.8, 3.2))
        for side in (-1, 1)
    ]
    shell["column"] = shapes.merged([moved(column, [x, y, 0]) for x, y, _ in spots])
    walk = (aisle - 2 * girth - 0.3, half[1] - 0.5)
    eye, gaze = (1.2, 2.6), (0.8, 0.4 * height)
    return Place(half, walk, eye, gaze, height, shell, tuple(spots), holes, True, near=1.6)


def _open(rng: Generator, kind: str) -> Place:
    ground = _ground(rng)
    blocks, trees, trunks, taken = [], [], [], []
    for angle in np.arange(0, 2 * np.pi, rng.uniform(0.35, 0.6)):
        far, size = rng.uniform(9.5, 14), rng.uniform(0.8, 2.2)
        x, y = far * np.cos(angle), far * np.sin(angle)
        if rng.random() < 0.5:
            blocks += [moved(_tower(rng, size), [x, y, -0.3], turn(rng.uniform(0, 6)))]
        elif rng.random() < 0.8:
            x, y = 0.75 * x, 0.75 * y
            crown, trunk = _tree(rng, size)
            trees.append(moved(crown, [x, y, 0]))
            trunks.append(moved(trunk, [x, y, -0.3]))
            taken.append((x, y, 0.5))
    shell = {"ground": ground}
    parts = (("block", blocks), ("leaf", trees), ("wood", trunks))
    shell |= {name: shapes.merged(part) for name, part in parts if part}
    half = (5.0, 5.0)
    return Place(half, (5.2, 5.2), (1.2, 2.6), (0.5, 1.3), 5.0, shell, tuple(taken), near=1.8)


def _water(rng: Generator, kind: str) -> Place:
    half = (rng.uniform(2.2, 4), rng.uniform(2.5, 4.5))
    deep = rng.uniform(0.25, 0.7)
    roof = kind == "lamps" or (kind == "sky" and rng.random() < 0.4)
    height = deep + (rng.uniform(2.6, 3.6) if roof else rng.uniform(0.4, 2.0))
    holes = {}
    if kind == "sky" and roof:  # through large openings, for the light must find the floor too
        holes[0] = _row(rng, 2 * half[0] - 0.5, rng.uniform(1.2, 2), 0.4, height)
        holes[4] = _row(rng, 2 * half[0] - 0.5, rng.uniform(1.2, 2), 0.3, 2 * half[1])
    shell, gaps = _walls(half, height, 0.25, holes, roof)
    shell = {name: moved(shape, [0, 0, -deep]) for name, shape in shell.items()}
    shell["water"] = shapes.sheet(2 * half[0] + 0.1, 2 * half[1] + 0.1, 80)
    walk = (half[0] - 0.35, half[1] - 0.35)
    top = height - deep if roof else 4.0
    return Place(half, walk, (0.8, 1.9), (-0.3, 0.4), top, shell, (), gaps, roof, -deep, 2.4, 1.0)


PLACES = {"room": _room, "hall": _hall, "open": _open, "water": _water}


def _row(rng: Generator, length: float, width: float, gap: float, height: float) -> list[Opening]:
    """Equal openings along a wall, about `gap` apart, in the upper part of its height."""
    count = max(1, int(length / (width + gap)))
    low, high = height * rng.uniform(0.15, 0.4), height * rng.uniform(0.7, 0.93)
    middles = (np.arange(count) + 0.5) * length / count - length / 2
    return [Opening(m - width / 2, m + width / 2, low, high) for m in middles]


def _walls(
    half: tuple[float, float],
    height: float,
    thick: float,
    openings: dict[int, list[Opening]],
    roof: bool,
) -> tuple[dict[str, Shape], tuple[Hole, ...]]:
    """Four walls (0 north, 1 west, 2 south, 3 east), floor, and perhaps a roof (4)."""
    walls, holes = [], []
    for k in range(4):
        row, spin = openings.get(k, []), turn(k * np.pi / 2)
        length = 2 * half[k % 2] + (2 * thick if k % 2 == 0 else 0)
        piece = shapes.wall(length, height, thick, row)
        walls.append(moved(moved(piece, [0, half[1 - k % 2], 0]), [0, 0, 0], spin))
        if row:
            outward = spin @ [0, 1, 0]
            holes.append(Hole(tuple(outward), _open_area(row)))
    x, y = 2 * half[0] + 2 * thick, 2 * half[1] + 2 * thick
    shell = {"floor": moved(shapes.box(x, y, 0.2), [0, 0, -0.2])}
    if roof:
        row = [o._replace(low=o.low + thick, high=o.high + thick) for o in openings.get(4, [])]
        flat = moved(shapes.wall(x, y, 0.2, row), [0, 0, 0], turn(np.pi / 2, 0))
        walls.append(moved(flat, [0, y / 2, height]))
        holes += [Hole((0.0, 0.0, 1.0), _open_area(row))] if row else []
    return shell | {"wall": shapes.merged(walls)}, tuple(holes)


def _open_area(row: Sequence[Opening]) -> float:
    return float(sum((o.right - o.left) * (o.high - o.low) for o in row))


def _ground(rng: Generator) -> Shape:
    """Gently wavy ground, flat and coarse towards a far horizon."""
    flat = shapes.sheet(60, 60, 64)
    plane = flat.vertices[:, :2]
    relief = shapes.lift(shapes.ripple(rng, 5, 6.0, rng.uniform(0, 0.1)), plane, 0.0) - 0.1
    reach = np.abs(plane).max(-1) / 30
    stretched = plane * (1 + 12 * reach[:, None] ** 6)
    height = relief * (1 - reach**2)
    return Shape(np.column_stack([stretched, height]), flat.faces, stretched)


def _column(rng: Generator, girth: float, height: float) -> Shape:
    """A round or square column with foot and head."""
    foot = shapes.box(3 * girth, 3 * girth, 0.25)
    shaft = shapes.cylinder(girth, height) if rng.random() < 0.6 else None
    shaft = shaft or shapes.box(1.8 * girth, 1.8 * girth, height)
    return shapes.merged([foot, shaft, moved(foot, [0, 0, height - 0.25])])


def _tower(rng: Generator, size: float) -> Shape:
    """Staggered blocks, each a little smaller than the one below."""
    blocks, z = [], 0.0
    for _ in range(int(rng.integers(1, 5))):
        rise = size * rng.uniform(0.6, 1.8)
        block = shapes.box(2 * size, 2 * size * rng.uniform(0.5, 1), rise)
        blocks.append(moved(block, [0, 0, z], turn(rng.uniform(-0.3, 0.3))))
        z, size = z + rise, size * rng.uniform(0.6, 0.95)
    return shapes.merged(blocks)


def _tree(rng: Generator, size: float) -> tuple[Shape, Shape]:
    """Crown of leaves and trunk."""
    height = 1.8 + size * rng.uniform(0.5, 1)
    radii = size * rng.uniform([0.7, 0.7, 0.6], [1, 1, 1.3])
    crown = shapes.leaves(rng, int(rng.integers(400, 1100)), radii, rng.uniform(0.12, 0.3))
    return moved(crown, [0, 0, height + radii[2] / 2]), shapes.cylinder(
        0.1 * size, height + 0.5, 0.6
    )

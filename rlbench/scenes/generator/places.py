"""Places and things for random scenes: rooms, halls, open ground, pools; furniture, bushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from rlbench.scenes.parts.shapes import (
    Shape,
    boxes,
    cylinder,
    grid,
    lathe,
    leaf_cloud,
    merge,
    rotation_matrix,
    transform,
    yaw_matrix,
)

Floats = NDArray[np.float64]


class Opening(NamedTuple):
    """A hole in a wall, in metres."""

    left: float  # along the wall, from its middle
    right: float
    low: float  # above its foot
    high: float


Rows = dict[int, list[Opening]]  # by wall: 0 north, 1 west, 2 south, 3 east, 4 roof


class Hole(NamedTuple):
    """What the light estimate needs to know of the openings in one wall."""

    outward: tuple[float, float, float]
    area: float  # m2, of all of them


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
    size: float = 1.0  # things are this much larger and more than usual


def room(rng: Generator, kind: str) -> Place:
    """A closed room with windows in one wall, or in two where daylight is all its light."""
    half, height = (rng.uniform(2.0, 3.5), rng.uniform(2.4, 4.5)), rng.uniform(2.4, 3.4)
    day = kind in ("sky", "sun", "sunsky")
    windows = {
        k: _row(rng, 2 * half[k % 2] - 0.4, rng.uniform(0.8, 1.8), 0.4 if day else 1.5, height)
        for k in rng.choice(4, 2 if day else 1, replace=False)
    }
    shell, holes = _walls(half, height, rng.uniform(0.1, 0.35), windows, roof=True)
    walk = (half[0] - 0.35, half[1] - 0.35)
    return Place(half, walk, (1.0, 1.9), (0.4, 1.2), height, shell, (), holes, roof=True)


def hall(rng: Generator, kind: str) -> Place:
    """A long hall with two rows of columns, slits along its walls, and perhaps in its roof."""
    half, height = (rng.uniform(3.5, 6), rng.uniform(7, 12)), rng.uniform(4, 7)
    slits = {k: _row(rng, 2 * half[1] - 1, rng.uniform(0.4, 0.9), 0.7, height) for k in (1, 3)}
    if rng.random() < 0.5 and kind not in ("lamps", "bulbs"):
        slits[4] = _row(rng, 2 * half[0] - 1, rng.uniform(0.3, 0.9), 0.5, 2 * half[1])
    shell, holes = _walls(half, height, rng.uniform(0.3, 0.6), slits, roof=True)
    girth = rng.uniform(0.15, 0.4)
    aisle = half[0] * rng.uniform(0.5, 0.7)
    column = _column(rng, girth, height)
    rows = np.arange(-half[1] + 1.2, half[1] - 0.8, rng.uniform(1.8, 3.2))
    spots = tuple((side * aisle, float(y), 2.2 * girth) for y in rows for side in (-1, 1))
    shell["column"] = merge(*(transform(column, [x, y, 0]) for x, y, _ in spots))
    walk = (aisle - 2 * girth - 0.3, half[1] - 0.5)
    place = Place(half, walk, (1.2, 2.6), (0.8, 0.4 * height), height, shell, spots, holes, True)
    return replace(place, near=1.6, size=1.4)


def field(rng: Generator, kind: str) -> Place:
    """Open ground to the horizon, ringed by staggered blocks and trees."""
    parts: dict[str, list[Shape]] = {"block": [], "leaf": [], "wood": []}
    taken = []
    for angle in np.arange(0, 2 * np.pi, rng.uniform(0.35, 0.6)):
        size = rng.uniform(0.8, 2.2)
        way = np.array([np.cos(angle), np.sin(angle)])
        if rng.random() < 0.5:
            spot = np.append(way * rng.uniform(10, 14), -0.3)  # with its foot in the ground
            parts["block"].append(transform(stack(rng, 3 * size), spot, yaw_matrix(angle)))
        elif rng.random() < 0.8:
            x, y = way * rng.uniform(7.5, 11)
            crown, trunk = _tree(rng, size)
            parts["leaf"].append(transform(crown, [x, y, 0]))
            parts["wood"].append(transform(trunk, [x, y, -0.3]))
            taken.append((float(x), float(y), 0.5))
    parts["ground"] = [_ground(rng)]
    shell = {name: merge(*part) for name, part in parts.items() if part}
    place = Place((5.0, 5.0), (5.2, 5.2), (1.2, 2.6), (0.5, 1.3), 5.0, shell, tuple(taken))
    return replace(place, near=1.8, size=1.4)


def water(rng: Generator, kind: str) -> Place:
    """A shallow pool from wall to wall: an open court, or a bath under large lamps or windows."""
    half, deep = (rng.uniform(2.2, 4), rng.uniform(2.5, 4.5)), rng.uniform(0.25, 0.7)
    roof = kind == "lamps" or (kind == "sky" and rng.random() < 0.4)
    height = deep + (rng.uniform(2.6, 3.6) if roof else rng.uniform(0.4, 2.0))
    holes = {}
    if kind == "sky" and roof:  # through large openings, for the light must find the floor too
        holes[0] = _row(rng, 2 * half[0] - 0.5, rng.uniform(1.2, 2), 0.4, height)
        holes[4] = _row(rng, 2 * half[0] - 0.5, rng.uniform(1.2, 2), 0.3, 2 * half[1])
    walls, gaps = _walls(half, height, 0.25, holes, roof)
    shell = {name: transform(shape, [0, 0, -deep]) for name, shape in walls.items()}
    shell["water"] = grid(2 * half[0] + 0.1, 2 * half[1] + 0.1, (80, 80))
    walk = (half[0] - 0.35, half[1] - 0.35)
    place = Place(half, walk, (0.8, 1.9), (-0.3, 0.4), height - deep, shell, (), gaps, roof, -deep)
    return replace(place, lamp=2.4, near=1.0)


def thing(rng: Generator, size: float) -> tuple[str, Shape]:
    """A random object that stands on the origin, and the name of its material."""
    names = ("solid0", "solid1", "solid2", "glass", "leaf")
    name = str(rng.choice(names, p=(0.27, 0.25, 0.2, 0.1, 0.18)))
    size *= rng.uniform(0.5, 1.1)
    if name == "leaf":
        radii = size * rng.uniform(0.25, 0.6, 3)
        bush = bushy(rng, int(rng.integers(150, 500)), radii, size * rng.uniform(0.08, 0.25))
        return name, transform(bush, [0, 0, radii[2] + 0.2 * size])
    makers = (ball, ring, crate, vase) if name == "glass" else (*SOLIDS, _rods, _table)
    item = makers[rng.integers(len(makers))](rng, size)
    return name, transform(item, [0, 0, 0], yaw_matrix(rng.uniform(0, 2 * np.pi)))


def ball(rng: Generator, size: float) -> Shape:
    """A sphere; by revolution, so that textures wrap it."""
    angle = np.linspace(0, np.pi, 17)
    return _turned(0.4 * size * np.stack([np.sin(angle).round(6), 1 - np.cos(angle)], -1))


def drum(rng: Generator, size: float) -> Shape:
    """A cylinder, a blunt or a pointed cone."""
    height, tip = size * rng.uniform(0.3, 1.5), float(rng.choice([1, 0.6, 0.05]))
    rims = [(0, 0), (0.3 * size, 0), (0.3 * size * tip, height), (0, height)]
    return merge(*(_turned(rims[k : k + 2]) for k in range(3)))  # apart, so that rims stay sharp


def ring(rng: Generator, size: float) -> Shape:
    """A torus that lies, or stands on its edge."""
    thick, wide = size * rng.uniform(0.06, 0.16), 0.35 * size
    angle = np.linspace(0, 2 * np.pi, 21)
    flat = _turned(np.stack([wide + thick * np.cos(angle), thick * (1 + np.sin(angle))], -1), 36)
    if rng.random() < 0.5:
        return flat
    return transform(flat, [0, thick, wide + thick], rotation_matrix((1, 0, 0), np.pi / 2))


def crate(rng: Generator, size: float) -> Shape:
    """A box of any proportions."""
    return _box(*(size * rng.uniform(0.3, 0.9, 3)))


def vase(rng: Generator, size: float) -> Shape:
    """A closed solid of revolution with a random smooth outline."""
    radii = 0.35 * size * rng.uniform(0.3, 1, 4)
    height = np.linspace(0, size * rng.uniform(0.7, 1.4), 25)
    radius = np.interp(height, np.linspace(0, height[-1], 4), radii)
    smooth = np.convolve(np.pad(radius, 3, "edge"), np.ones(7) / 7, "valid")
    return _turned([[0, 0], *np.stack([smooth, height], -1), [0, height[-1]]])


def stack(rng: Generator, size: float) -> Shape:
    """Staggered blocks, one upon the other."""
    z, blocks = 0.0, []
    for _ in range(int(rng.integers(2, 6))):
        x, y, rise = size * rng.uniform([0.3, 0.3, 0.15], [0.8, 0.8, 0.5])
        a, b, angle = rng.uniform(-1, 1, 3) * [0.06 * size, 0.06 * size, 0.5]
        blocks.append(transform(_box(x, y, rise), [a, b, z], yaw_matrix(angle)))
        z += rise
    return merge(*blocks)


def bushy(rng: Generator, count: int, radii: Floats, size: float) -> Shape:
    """Loose leaves of side about `size` in an ellipsoid about the origin."""
    foliage = leaf_cloud(rng, np.zeros((count, 3)), 1.0, size / float(radii.mean()))
    return foliage._replace(vertices=foliage.vertices * radii.astype(np.float32))


PLACES = {"room": room, "hall": hall, "open": field, "water": water}
SOLIDS = (ball, drum, ring, crate, vase, stack)


def _row(rng: Generator, length: float, width: float, gap: float, height: float) -> list[Opening]:
    """Equal openings along a wall, about `gap` apart, in the upper part of its height."""
    count = max(1, int(length / (width + gap)))
    low, high = height * rng.uniform(0.15, 0.4), height * rng.uniform(0.7, 0.93)
    middles = (np.arange(count) + 0.5) * length / count - length / 2
    return [Opening(m - width / 2, m + width / 2, low, high) for m in middles]


def _walls(
    half: tuple[float, float], height: float, thick: float, openings: Rows, roof: bool
) -> tuple[dict[str, Shape], tuple[Hole, ...]]:
    """Floor, four walls, perhaps a roof, and where light comes in."""
    x, y = (2 * (side + thick) for side in half)
    walls = []
    for k in range(4):
        wall = _wall((x, 2 * half[1])[k % 2], height, thick, openings.get(k, []))
        walls.append(
            transform(transform(wall, [0, half[1 - k % 2], 0]), 0, yaw_matrix(k * np.pi / 2))
        )
    if roof:
        flat = _wall(x, y, 0.2, openings.get(4, []))
        walls.append(transform(flat, [0, y / 2, height], rotation_matrix((1, 0, 0), np.pi / 2)))
    holes = []
    for k, row in openings.items():
        area = sum((o.right - o.left) * (o.high - o.low) for o in row)
        x_out, y_out = (0.0, 0.0) if k == 4 else yaw_matrix(k * np.pi / 2)[:2, 1]
        holes.append(Hole((float(x_out), float(y_out), float(k == 4)), float(area)))
    floor = boxes([-x / 2, -y / 2, -0.2], [x / 2, y / 2, 0])
    return {"floor": floor, "wall": merge(*walls)}, tuple(holes)


def _wall(length: float, height: float, thick: float, openings: Sequence[Opening]) -> Shape:
    """A wall along x, centred, its inner face in y = 0 and its body behind."""
    pieces, left = [], -length / 2
    for hole in sorted(openings):
        pieces += [(left, hole.left, 0.0, height), (hole.left, hole.right, 0.0, hole.low)]
        pieces += [(hole.left, hole.right, hole.high, height)]
        left = hole.right
    a, b, c, d = np.array([*pieces, (left, length / 2, 0.0, height)]).T
    return boxes(np.stack([a, 0 * a, c], -1), np.stack([b, 0 * b + thick, d], -1))


def _ground(rng: Generator) -> Shape:
    """Gently wavy ground, flat and coarse towards a far horizon."""
    plane = (flat := grid(60, 60, (64, 64))).vertices[:, :2]
    reach = np.abs(plane).max(-1) / 30
    swell = np.sin(plane @ rng.normal(size=(2, 5)) * 0.8 + rng.uniform(0, 6, 5)) @ np.ones(5)
    height = (1 - reach**2) * rng.uniform(0, 0.03) * (swell - 5)
    stretched = plane * (1 + 12 * reach[:, None] ** 6)
    return Shape(np.column_stack([stretched, height]).astype(np.float32), flat.faces, stretched)


def _column(rng: Generator, girth: float, height: float) -> Shape:
    """A round or square column with foot and head."""
    foot = _box(3 * girth, 3 * girth, 0.25)
    shaft = cylinder(girth, 0, height) if rng.random() < 0.6 else _box(2 * girth, girth, height)
    return merge(foot, shaft, transform(foot, [0, 0, height - 0.25]))


def _tree(rng: Generator, size: float) -> tuple[Shape, Shape]:
    """Crown of leaves and trunk."""
    height, radii = 1.8 + size * rng.uniform(0.5, 1), size * rng.uniform(0.65, 1.2, 3)
    crown = bushy(rng, int(rng.integers(400, 1100)), radii, rng.uniform(0.12, 0.3))
    return transform(crown, [0, 0, height + radii[2] / 2]), cylinder(0.08 * size, 0, height + 0.5)


def _rods(rng: Generator, size: float) -> Shape:
    """A thicket of thin leaning bars."""
    rods, shear = [], np.eye(3, dtype=np.float32)
    for _ in range(int(rng.integers(3, 14))):
        bar = cylinder(rng.uniform(0.008, 0.03), 0, size * rng.uniform(0.8, 2), sides=6)
        shear[:2, 2] = rng.uniform(-0.2, 0.2, 2)
        rods.append(transform(bar, [*rng.uniform(-0.4, 0.4, 2) * size, 0], shear))
    return merge(*rods)


def _table(rng: Generator, size: float) -> Shape:
    x, y, z = size * rng.uniform([0.7, 0.5, 0.4], [1.2, 0.9, 0.8])
    feet = 0.45 * np.array([[x, y, 0], [-x, y, 0], [x, -y, 0], [-x, -y, 0]])
    return merge(
        boxes(feet - [0.03, 0.03, 0], feet + [0.03, 0.03, z]),
        transform(_box(x, y, 0.05), [0, 0, z]),
    )


def _box(x: float, y: float, z: float) -> Shape:
    return boxes([-x / 2, -y / 2, 0], [x / 2, y / 2, z])


def _turned(profile: ArrayLike, sides: int = 32) -> Shape:
    """A solid of revolution, without the empty triangles at its poles."""
    shape = lathe([(float(r), float(z)) for r, z in np.asarray(profile)], sides)
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    full = np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 1e-12
    return shape._replace(faces=shape.faces[full])

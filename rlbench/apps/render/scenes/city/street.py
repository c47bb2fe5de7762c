"""Street furniture: lamp posts, benches, bollards, café tables under parasols, and planters.

The furniture is coloured by a palette: `wood`, `iron` and `cloth` are colour numbers in it.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    boxes,
    disc,
    icosphere,
    lathe,
    merge,
    paint,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)

Positions = tuple[tuple[float, float], ...]
CAR_COLOURS = (
    (0.42, 0.02, 0.02),  # 0 to 3: body
    (0.02, 0.09, 0.14),
    (0.55, 0.52, 0.43),
    (0.24, 0.30, 0.27),
    (0.010, 0.013, 0.016),  # 4 windows
    (0.018, 0.018, 0.018),  # 5 tyres and arches
    (0.22, 0.22, 0.22),  # 6 bright parts
    (0.30, 0.012, 0.01),  # 7 tail lamps
    (0.75, 0.72, 0.62),  # 8 head lamps
)
AXLES, WHEEL_RADIUS = (-1.28, 1.27), 0.31  # metres
GLASS, TYRE, BRIGHT, TAIL, HEAD = 4, 5, 6, 7, 8

# cross-sections from tail to nose, metres: x, sill, belt line, roof, half width
STATIONS = np.array(
    [
        (-1.98, 0.42, 0.66, 0.70, 0.66),
        (-1.95, 0.34, 0.78, 0.86, 0.74),
        (-1.85, 0.28, 0.85, 0.95, 0.79),
        (-1.55, 0.26, 0.89, 1.02, 0.82),
        (-1.42, 0.25, 0.90, 1.10, 0.825),
        (-1.05, 0.24, 0.91, 1.39, 0.83),
        (-0.80, 0.24, 0.91, 1.45, 0.83),
        (-0.20, 0.24, 0.91, 1.49, 0.83),
        (0.30, 0.24, 0.90, 1.45, 0.83),
        (0.45, 0.24, 0.90, 1.39, 0.83),
        (0.95, 0.25, 0.89, 1.00, 0.82),
        (1.10, 0.25, 0.87, 0.94, 0.82),
        (1.60, 0.27, 0.80, 0.87, 0.79),
        (1.86, 0.29, 0.74, 0.80, 0.75),
        (1.96, 0.33, 0.66, 0.72, 0.70),
        (2.00, 0.42, 0.60, 0.64, 0.64),
    ]
)


def build_lamp_posts(positions: Positions) -> Shape:
    """Cast-iron lamp posts with two arms, each with a lantern."""
    arm = [
        transform(_build_lamp_arm(0.5, 0.032), (0, 0, 3.55), yaw_matrix(turn))
        for turn in (0.0, np.pi)
    ]
    lantern = lathe([(0.05, -0.30), (0.10, -0.28), (0.17, 0.06), (0.20, 0.08), (0.03, 0.25)], 6)
    hung = [transform(lantern, (x, 0, 3.52)) for x in (-1.0, 1.0)]
    base = [(0.24, 0), (0.24, 0.08), (0.15, 0.14), (0.15, 0.6), (0.10, 0.68), (0.065, 0.8)]
    shaft = [(0.05, 3.3), (0.09, 3.34), (0.09, 3.42), (0.05, 3.46), (0.04, 4.1), (0.005, 4.3)]
    post = merge(lathe(base + shaft, 14), *arm, *hung)
    return merge(*(transform(post, (x, y, 0), yaw_matrix(0.4 * x)) for x, y in positions))


def _build_lamp_arm(radius: float, tube_radius: float) -> Shape:
    """A pipe in the plane y = 0 that arches from the origin to x = 2 radius."""
    angle = np.linspace(np.pi, 0.0, 13)
    middle = np.stack([radius + radius * np.cos(angle), 0 * angle, 0.6 * np.sin(angle)], -1)
    turn = np.linspace(0, 2 * np.pi, 7)
    out = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
    ring = np.cos(turn)[:, None, None] * out[None] + np.sin(turn)[:, None, None] * np.array(
        [0, 1, 0]
    )
    points = middle[None] + tube_radius * ring  # 7 13 3
    return quads(
        points[:-1, :-1].reshape(-1, 3),
        (points[:-1, 1:] - points[:-1, :-1]).reshape(-1, 3),
        (points[1:, :-1] - points[:-1, :-1]).reshape(-1, 3),
    )


def build_benches(
    placements: tuple[tuple[float, float, float], ...], wood: int, iron: int, palette_size: int
) -> Shape:
    """Slatted benches at (x, y, yaw); an unturned bench faces -y."""
    slats = boxes(
        [(-0.9, y, 0.43) for y in (-0.22, -0.07, 0.08)]
        + [(-0.9, 0.24 + 0.03 * k, 0.52 + 0.15 * k) for k in range(3)],
        [(0.9, y + 0.12, 0.46) for y in (-0.22, -0.07, 0.08)]
        + [(0.9, 0.27 + 0.03 * k, 0.63 + 0.15 * k) for k in range(3)],
    )
    legs = boxes(
        [(x, y, 0) for x in (-0.75, 0.7) for y in (-0.2, 0.2)],
        [(x + 0.05, y + 0.05, 0.43 if y < 0 else 0.9) for x in (-0.75, 0.7) for y in (-0.2, 0.2)],
    )
    bench = merge(paint(slats, wood, palette_size), paint(legs, iron, palette_size))
    return merge(*(transform(bench, (x, y, 0), yaw_matrix(turn)) for x, y, turn in placements))


def build_bollards(positions: Positions) -> Shape:
    """Low iron posts with a round head."""
    foot, head = [(0.08, 0), (0.08, 0.1), (0.05, 0.15)], [(0.06, 0.68), (0.05, 0.76), (0.01, 0.8)]
    bollard = lathe([*foot, (0.04, 0.64), *head], 12)
    return merge(*(transform(bollard, (x, y, 0)) for x, y in positions))


def build_cafe_tables(
    positions: Positions, cloth: tuple[int, int], wood: int, iron: int, palette_size: int
) -> Shape:
    """Round tables with three chairs under a striped parasol."""
    top = merge(
        transform(disc(0.42, 0, 24), (0, 0, 0.74)),
        lathe([(0.42, 0.70), (0.42, 0.74)], 24),
    )
    pole = lathe([(0.26, 0.0), (0.25, 0.06), (0.03, 0.08), (0.024, 2.5)], 10)
    parts = [
        paint(top, wood, palette_size),
        paint(pole, iron, palette_size),
        _build_parasol(cloth, palette_size),
    ]
    chair = _build_chair(wood, iron, palette_size)
    for turn in (0.3, 2.5, 4.4):
        parts.append(
            transform(chair, (-0.75 * np.sin(turn), 0.75 * np.cos(turn), 0), yaw_matrix(turn))
        )
    table = merge(*parts)
    return merge(*(transform(table, (x, y, 0), yaw_matrix(x + y)) for x, y in positions))


def _build_chair(wood: int, iron: int, palette_size: int) -> Shape:
    seat = boxes([(-0.2, -0.2, 0.43), (-0.2, 0.17, 0.6)], [(0.2, 0.2, 0.46), (0.2, 0.2, 0.86)])
    feet = np.array([(x, y, 0) for x in (-0.2, 0.17) for y in (-0.2, 0.17)])
    heights = np.where(feet[:, 1] > 0, 0.86, 0.44)
    legs = boxes(feet, feet + np.stack([0 * heights + 0.03, 0 * heights + 0.03, heights], -1))
    return merge(paint(seat, wood, palette_size), paint(legs, iron, palette_size))


def _build_parasol(cloth: tuple[int, int], palette_size: int) -> Shape:
    """A parasol of eight gores in alternating colours, with a hanging rim."""
    sides = 16
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    out = np.stack([np.cos(angle), np.sin(angle)], -1)

    def ring(radius: float, height: float) -> Float64Array:
        return np.concatenate([radius * out, np.full((sides + 1, 1), height)], -1)

    parts = []
    outline = [(1.35, 1.88), (1.35, 2.05), (0.7, 2.38), (0.03, 2.58)]
    for inner, outer in pairwise(outline):
        lower, upper = ring(*inner), ring(*outer)
        gore = quads(lower[:-1], lower[1:] - lower[:-1], upper[:-1] - lower[:-1])
        gore.vertices.reshape(-1, 4, 3)[:, 2] = upper[1:]
        colours = np.array(cloth)[np.arange(sides) // 2 % 2].repeat(4)
        parts.append(paint(gore, colours, palette_size))
    return merge(*parts)


def build_planters(
    random: np.random.Generator,
    positions: Positions,
    wood: int,
    blooms: tuple[int, ...],
    palette_size: int,
) -> Shape:
    """Wooden boxes full of small flowers; `blooms` are their colours."""
    parts = []
    for x, y in positions:
        crate = boxes((x - 0.6, y - 0.25, 0), (x + 0.6, y + 0.25, 0.5))
        parts.append(paint(crate, wood, palette_size))
        for _ in range(90):
            at = random.uniform((x - 0.58, y - 0.23, 0.48), (x + 0.58, y + 0.23, 0.75))
            turn = rotation_matrix(random.normal(size=3), random.uniform(0, 3))
            flower = transform(icosphere(0), at, turn, random.uniform(0.03, 0.07))
            parts.append(paint(flower, random.choice(blooms), palette_size))
    return merge(*parts)


@lru_cache(maxsize=8)
def build_car(body_colour: int = 0) -> Shape:
    """The car about the origin, on the ground, facing +x.

    `body_colour` is one of the first four CAR_COLOURS, 0 to 3.
    """
    size = len(CAR_COLOURS)
    parts = [*_build_hull(body_colour), *_build_wheels()]
    fittings = [
        (BRIGHT, (1.92, -0.72, 0.36), (2.06, 0.72, 0.45)),
        (BRIGHT, (-2.05, -0.72, 0.40), (-1.92, 0.72, 0.49)),
        (TYRE, (1.90, -0.34, 0.46), (2.02, 0.34, 0.58)),
        (TAIL, (-1.975, -0.70, 0.58), (-1.90, -0.46, 0.72)),
        (TAIL, (-1.975, 0.46, 0.58), (-1.90, 0.70, 0.72)),
        (BRIGHT, (-1.99, -0.2, 0.54), (-1.9, 0.2, 0.64)),
    ]
    parts += [paint(boxes(low, high), colour, size) for colour, low, high in fittings]
    forward = rotation_matrix((0, 1, 0), np.pi / 2)
    for y in (-0.54, 0.54):
        lamp = merge(disc(0.09, 0.03, 20), lathe([(0.12, 0), (0.12, 0.02), (0.09, 0.03)], 20))
        parts.append(paint(transform(lamp, (1.97, y, 0.56), forward), HEAD, size))
    for y in (-0.93, 0.82):
        parts.append(paint(boxes((0.42, y, 0.93), (0.54, y + 0.11, 1.05)), body_colour, size))
    return merge(*parts)


def _build_hull(body_colour: int) -> list[Shape]:
    """The body as a sheet over cross-sections, split by colour."""
    stations = _resample_stations(STATIONS, 73)
    x, sill, belt, top, half = stations.T
    arch = [
        np.sqrt(np.clip((WHEEL_RADIUS + 0.07) ** 2 - (x - axle) ** 2, 0, None)) for axle in AXLES
    ]
    sill = np.maximum(sill, np.max(arch, 0) + WHEEL_RADIUS)
    cabin = np.clip((top - belt - 0.12) / 0.45, 0, 1)  # 0 at bonnet and boot, 1 at the roof
    inset = half - 0.02 - 0.20 * cabin
    ones = np.ones_like(x)
    section = [  # (y, z) of half a cross-section, from the sill to the middle of the roof
        (half - 0.05, sill),
        (half - 0.01, sill + 0.08 * (belt - sill)),
        (half + 0.012, 0.5 * (sill + belt)),
        (half, belt - 0.06),
        (half - 0.025, belt),
        (half - 0.045 - 0.02 * cabin, belt + 0.03 * cabin + 0.004),
        (inset + 0.02, top - 0.07 * cabin - 0.02),
        (inset - 0.03, top - 0.035 * cabin - 0.008),
        (0.8 * inset, top - 0.008),
        (0.4 * inset, top + 0.012),
        (0.0 * ones, top + 0.016),
    ]
    right = np.stack([np.stack([x, -y, z], -1) for y, z in section], 1)  # station section 3
    left = (right * (1, -1, 1))[:, -2::-1]
    sheet = np.concatenate([right, left], 1)
    bands = sheet.shape[1] - 1
    middle = 0.5 * (x[:-1] + x[1:])
    slope = np.abs(np.diff(top) / np.diff(x))
    is_glass = np.zeros((len(middle), bands), bool)
    panes = (cabin[:-1] > 0.25) & (cabin[1:] > 0.25) & (np.abs(middle + 0.30) > 0.045)
    is_glass[np.ix_(panes & (middle < 0.62) & (middle > -1.2), [5, bands - 6])] = True
    screens = (slope > 0.42) & (top[:-1] > 0.98) & (top[1:] > 0.98)
    is_glass[np.ix_(screens, list(range(8, bands - 8)))] = True
    colours = np.where(is_glass, GLASS, body_colour)
    ends = [_build_end_cap(sheet[0], body_colour), _build_end_cap(sheet[-1][::-1], body_colour)]
    under = boxes(
        (-1.85, -0.7, 0.24), (1.85, 0.7, 0.62)
    )  # hides the ground behind the wheel arches
    return [*_split_by_colour(sheet, colours), *ends, paint(under, TYRE, len(CAR_COLOURS))]


def _build_wheels() -> list[Shape]:
    tyre = lathe(
        [
            (0.19, 0.0),
            (0.27, -0.012),
            (0.30, 0.01),
            (WHEEL_RADIUS, 0.04),
            (WHEEL_RADIUS, 0.14),
            (0.29, 0.19),
        ],
        32,
    )
    back = disc(0.29, 0.19, 32)
    hub = merge(
        lathe([(0.05, -0.015), (0.10, -0.012), (0.19, 0.012)], 24),
        lathe([(0.19, 0.0), (0.20, -0.01), (0.21, 0.0)], 24),
    )
    rim = merge(
        hub, transform(disc(0.052, 0.016, 16), (0, 0, 0), rotation_matrix((1, 0, 0), np.pi))
    )
    parts = []
    for axle in AXLES:
        for mirror in (0.0, np.pi):
            turn = rotation_matrix((0, 0, 1), mirror) @ rotation_matrix((1, 0, 0), -np.pi / 2)
            at = (axle, 0.80 if mirror else -0.80, WHEEL_RADIUS)
            parts += [
                paint(transform(merge(tyre, back), at, turn), TYRE, len(CAR_COLOURS)),
                paint(transform(rim, at, turn), BRIGHT, len(CAR_COLOURS)),
            ]
    return parts


def _resample_stations(stations: Float64Array, count: int) -> Float64Array:
    """`count` cross-sections at equal distances along the car, smoothed."""
    x = np.linspace(stations[0, 0], stations[-1, 0], count)
    columns = [np.interp(x, stations[:, 0], column) for column in stations.T[1:]]
    kernel = np.array([1, 4, 6, 4, 1]) / 16
    rounded = [np.convolve(np.pad(c, 2, "edge"), kernel, "valid") for c in columns]
    return np.stack([x, *rounded], -1)


def _split_by_colour(sheet: Float64Array, colours: NDArray[np.int64]) -> list[Shape]:
    """The cells of a sheet [rows columns 3] as one shape for each colour."""
    rows, columns = sheet.shape[:2]
    first = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    shapes = []
    for colour in np.unique(colours):
        a = first[colours == colour]
        b, c, d = a + columns, a + columns + 1, a + 1
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
        used, faces = np.unique(faces, return_inverse=True)
        vertices = sheet.reshape(-1, 3)[used].astype(np.float32)
        shape = Shape(vertices, faces.reshape(-1, 3).astype(np.uint32), vertices[:, :2])
        shapes.append(paint(shape, int(colour), len(CAR_COLOURS)))
    return shapes


def _build_end_cap(outline: Float64Array, body_colour: int) -> Shape:
    """A flat end of the hull."""
    middle = outline.mean(0, keepdims=True)
    vertices = np.concatenate([outline, middle]).astype(np.float32)
    first = np.arange(len(outline))
    faces = np.stack([first, np.roll(first, -1), np.full(len(outline), len(outline))], -1)
    faces = faces[:, ::-1]
    return paint(
        Shape(vertices, faces.astype(np.uint32), vertices[:, :2]), body_colour, len(CAR_COLOURS)
    )

"""Street furniture: lamp posts, benches, bollards, café tables under parasols, and planters.

The furniture is coloured by a palette: `wood`, `iron` and `cloth` are colour numbers in it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rlbench.scenes.parts.primitives import boxes, disc, icosphere, lathe, quads
from rlbench.scenes.parts.shape import (
    Float64Array,
    Shape,
    merge,
    paint,
    rotation_matrix,
    transform,
    yaw_matrix,
)

Positions = tuple[tuple[float, float], ...]


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

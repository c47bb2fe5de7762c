"""Arcades of the temple: two rows of columns with capitals, round arches and friezes."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.parts.primitives import boxes, fluted_column
from rlbench.scenes.parts.shape import Shape, merge, transform, yaw_matrix
from rlbench.scenes.parts.sheets import arch_wall, leaf_blade, moulding
from rlbench.scenes.temple.stone import (
    COLUMN_Y,
    HEIGHT,
    LENGTH,
    NAVE_HALF_WIDTH,
    SPRING_HEIGHT,
    WINDOW_Y,
)


def build_arcades() -> Shape:
    """Two rows of columns with leafy capitals, round arches and a carved frieze."""
    one = merge(
        fluted_column(SPRING_HEIGHT, 0.5, 72, 18), _build_capital_leaves(SPRING_HEIGHT, 0.5)
    )
    span = merge(
        arch_wall(1.28, 2.0, SPRING_HEIGHT, HEIGHT, 0.7), moulding(1.28, 0.26, SPRING_HEIGHT, 0.84)
    )
    first = arch_wall(1.28, 1.5, SPRING_HEIGHT, HEIGHT, 0.7)  # over the half bay at either end
    parts = []
    for x in (-NAVE_HALF_WIDTH, NAVE_HALF_WIDTH):
        parts += [transform(one, (x, y, 0)) for y in COLUMN_Y]
        parts += [transform(span, (x, y, 0), yaw_matrix(np.pi / 2)) for y in WINDOW_Y]
        parts += [transform(first, (x, y, 0), yaw_matrix(np.pi / 2)) for y in (1.5, 28.5)]
        parts.append(boxes((x - 0.35, -4, SPRING_HEIGHT), (x + 0.35, 0, HEIGHT), tile_size=3.0))
        parts.append(_build_frieze(x, -np.sign(x)))
    return merge(*parts)


def _build_capital_leaves(height: float, radius: float) -> Shape:
    """Two rows of eight leaves that bend outward from a capital."""
    foot = height - 1.15 * radius
    leaf = leaf_blade(0.85 * radius, 0.42 * radius, 1.5, 2.1)
    parts = []
    for row, grow in enumerate((0.85, 1.15)):
        for number in range(8):
            angle = (number + row / 2) * np.pi / 4
            at = 0.86 * radius * np.array([np.cos(angle), np.sin(angle), 0]) + (0, 0, foot)
            parts.append(transform(leaf, at, yaw_matrix(angle), grow))
    return merge(*parts)


def _build_frieze(x: float, inward: float) -> Shape:
    """A meander between two mouldings, and dentils below the ceiling, on a wall of the nave."""
    key = [(0, 0, 0.9, 0.1), (0, 0.1, 0.1, 0.6), (0.1, 0.5, 0.8, 0.6), (0.7, 0.2, 0.8, 0.5)]
    key += [(0.3, 0.2, 0.7, 0.3), (0.3, 0.3, 0.4, 0.42)]
    starts = np.arange(-4.0, LENGTH - 0.5, 0.9)
    face = x + 0.35 * inward
    cut = [(face, s + a, 7.45 + b, s + c, 7.45 + d, 0.06) for s in starts for a, b, c, d in key]
    cut += [(face, -4, z, LENGTH, z + 0.12, 0.11) for z in (7.25, 8.12)]
    cut += [(face, y, 8.4, y + 0.14, 8.62, 0.2) for y in np.arange(-4, LENGTH, 0.34)]
    wall, y0, z0, y1, z1, out = np.array(cut).T
    x0, x1 = np.sort([wall - 0.02 * inward, wall + out * inward], axis=0)
    return boxes(np.stack([x0, y0, z0], -1), np.stack([x1, y1, z1], -1), tile_size=3.0)

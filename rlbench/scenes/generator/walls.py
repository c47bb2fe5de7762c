"""Walls with rows of openings, around a rectangular floor and perhaps under a roof."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.scenes.parts.primitives import boxes
from rlbench.scenes.parts.shape import Shape, merge, rotation_matrix, transform, yaw_matrix


class Opening(NamedTuple):
    """A rectangular opening in a wall, in metres."""

    left: float  # along the wall, from its middle
    right: float
    low: float  # above the foot of the wall
    high: float


Openings = dict[int, list[Opening]]  # by wall: 0 north, 1 west, 2 south, 3 east, 4 roof


class Aperture(NamedTuple):
    """All openings of one wall, as the estimate of the mean radiance needs them."""

    outward: tuple[float, float, float]  # unit normal of the wall
    area: float  # m2, total


def opening_row(
    rng: Generator, length: float, width: float, spacing: float, height: float
) -> list[Opening]:
    """Equal openings along a wall, about `spacing` apart, in its upper part; all in metres."""
    count = max(1, int(length / (width + spacing)))
    low, high = height * rng.uniform(0.15, 0.4), height * rng.uniform(0.7, 0.93)
    centres = (np.arange(count) + 0.5) * length / count - length / 2
    return [Opening(x - width / 2, x + width / 2, low, high) for x in centres]


def build_walls(
    half: tuple[float, float], height: float, thickness: float, openings: Openings, has_roof: bool
) -> tuple[dict[str, Shape], tuple[Aperture, ...]]:
    """Floor and walls by part name, with or without a roof, and the apertures that admit light."""
    x, y = (2 * (side + thickness) for side in half)
    walls = []
    for k in range(4):
        wall = _build_wall((x, 2 * half[1])[k % 2], height, thickness, openings.get(k, []))
        walls.append(
            transform(transform(wall, [0, half[1 - k % 2], 0]), 0, yaw_matrix(k * np.pi / 2))
        )
    if has_roof:
        flat = _build_wall(x, y, 0.2, openings.get(4, []))
        walls.append(transform(flat, [0, y / 2, height], rotation_matrix((1, 0, 0), np.pi / 2)))
    apertures = []
    for k, row in openings.items():
        area = sum((one.right - one.left) * (one.high - one.low) for one in row)
        x_out, y_out = (0.0, 0.0) if k == 4 else yaw_matrix(k * np.pi / 2)[:2, 1]
        apertures.append(Aperture((float(x_out), float(y_out), float(k == 4)), float(area)))
    floor = boxes([-x / 2, -y / 2, -0.2], [x / 2, y / 2, 0])
    return {"floor": floor, "wall": merge(*walls)}, tuple(apertures)


def _build_wall(
    length: float, height: float, thickness: float, openings: Sequence[Opening]
) -> Shape:
    """A wall along x, centred on the origin, with its inner face at y = 0 and its body behind."""
    pieces, left = [], -length / 2
    for opening in sorted(openings):
        pieces += [
            (left, opening.left, 0.0, height),
            (opening.left, opening.right, 0.0, opening.low),
        ]
        pieces += [(opening.left, opening.right, opening.high, height)]
        left = opening.right
    a, b, c, d = np.array([*pieces, (left, length / 2, 0.0, height)]).T
    return boxes(np.stack([a, 0 * a, c], -1), np.stack([b, 0 * b + thickness, d], -1))

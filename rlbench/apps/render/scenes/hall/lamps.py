"""Lamps: position and colour of about a thousand small lights, and the tubes above them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Float64Array,
    Shape,
    merge,
    quads,
    yaw_matrix,
)

HALF_WIDTH, LENGTH, HEIGHT = 7.0, 34.0, 7.0  # metres
RING_Y, RING_Z = 15.0, 2.95  # metres: centre of the great rings
CYAN, AMBER, ROSE, WHITE = range(4)  # indices of RADIANCE
RADIANCE = ((0.10, 0.62, 0.85), (0.85, 0.36, 0.05), (0.85, 0.07, 0.30), (0.55, 0.60, 0.66))
CONSOLES = ((-4.3, 6.2, 0.5), (4.0, 5.2, -0.6), (-3.9, 11.6, 0.35))  # x, y, yaw


class Lamps(NamedTuple):
    """Rectangular lamps that emit along across x up."""

    corner: Float64Array  # n 3
    across: Float64Array  # n 3
    up: Float64Array  # n 3
    colour: NDArray[np.int64]  # n, indices of RADIANCE


def fixed_lamps(random: np.random.Generator) -> Lamps:
    """All lamps that belong to the building."""
    return concatenate_lamps(
        [
            _strip_lamps(random),
            _sign_lamps(random),
            _console_lamps(random),
            _gate_lamps(),
            _floor_lamps(),
        ]
    )


def concatenate_lamps(groups: Sequence[Lamps]) -> Lamps:
    """One table with the lamps of all groups, in their order."""
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def transform_lamps(lamps: Lamps, translation: ArrayLike, rotation: Float32Array) -> Lamps:
    """The lamps rotated, then translated."""
    corner, across, up = (v @ rotation.T.astype(float) for v in lamps[:3])
    return Lamps(corner + np.asarray(translation, float), across, up, lamps.colour)


def lamp_circle(count: int, radius: float, size: tuple[float, float], colour: int) -> Lamps:
    """Lamps in a circle about the origin, in the plane of x and z, that emit towards -y."""
    angle = np.arange(count) * (2 * np.pi / count)
    outward = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
    along = np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], -1)
    corner = radius * outward - size[0] / 2 * along
    # along x outward points to -y
    return Lamps(corner, size[0] * along, size[1] * outward, np.full(count, colour))


def build_tubes() -> Shape:
    """Tubes on the slopes and panels in the ceiling of each bay; they give most of the light."""
    bays = np.arange(-1.0, LENGTH, 4.0)
    places = [(side, y) for y in bays for side in (-1.0, 1.0)]
    slopes = quads(
        [(side * 5.72, y + 1.5 * side, 5.72) for side, y in places],
        [(0, -3.0 * side, 0) for side, _ in places],
        [(-0.2 * side, 0, 0.2) for side, _ in places],
        tile_size=0,
    )
    corner = [(2.35 * side - 0.3, y - 1.3, HEIGHT - 0.02) for side, y in places]
    return merge(slopes, quads(corner, (0, 2.6, 0), (0.6, 0, 0), tile_size=0))


def _strip_lamps(random: np.random.Generator) -> Lamps:
    """Two dashed lines of small lamps along each long wall, cyan below and rose or amber above."""
    y = np.arange(-3.5, LENGTH - 0.5, 0.3)
    groups = []
    for side in (-1.0, 1.0):
        for height, colour in ((0.74, CYAN), (3.34, ROSE if side < 0 else AMBER)):
            keep = y[random.random(len(y)) < 0.85]
            depth = HALF_WIDTH - (1.32 if height < 1 else 0.91)
            x = np.full_like(keep, side * depth)
            corner = np.stack([x, keep + (0.22 if side > 0 else 0), np.full_like(keep, height)], -1)
            length = random.uniform(0.12, 0.27, (len(keep), 1))
            up = np.array([[0, 0, 0.12]]).repeat(len(keep), 0)
            across = length * (0, -side, 0)
            groups.append(Lamps(corner, across, up, np.full(len(keep), colour)))
    return concatenate_lamps(groups)


def _sign_lamps(random: np.random.Generator) -> Lamps:
    """Panels of small lamps on the walls, in random colours and sizes."""
    groups = []
    for number, y in enumerate((7.0, 11.0, 19.0)):
        side = 1.0 if number % 2 else -1.0
        lamps = _lamp_matrix(random, (6, 12), 0.2)
        groups.append(
            transform_lamps(
                lamps, (side * (HALF_WIDTH - 0.3), y, 1.5), yaw_matrix(-side * np.pi / 2)
            )
        )
    return concatenate_lamps(groups)


def _console_lamps(random: np.random.Generator) -> Lamps:
    """Buttons and screens of the consoles."""
    return concatenate_lamps(
        [
            transform_lamps(_lamp_matrix(random, (5, 10), 0.13), (x, y, 1.02), yaw_matrix(turn))
            for x, y, turn in CONSOLES
        ]
    )


def _lamp_matrix(random: np.random.Generator, count: tuple[int, int], pitch: float) -> Lamps:
    """Rows and columns of lamps above z = 0, centred on x = 0, that emit towards -y."""
    rows, columns = np.indices(count).reshape(2, -1)
    size = pitch * random.choice([0.2, 0.4, 0.7, 0.85], (rows.size, 1))
    x = pitch * (columns - count[1] / 2)
    corner = np.stack([x, 0 * x, pitch * rows], -1)
    colour = random.choice([CYAN, CYAN, WHITE, AMBER, ROSE], rows.size)
    return Lamps(corner, size * (1.1, 0, 0), size * (0, 0, 1.0), colour)


def _gate_lamps() -> Lamps:
    """A ring of lamps around the gate at the far end."""
    ring = lamp_circle(48, 2.2, (0.24, 0.22), WHITE)
    return transform_lamps(ring, (0, LENGTH - 1.35, RING_Z), np.eye(3, dtype=np.float32))


def _floor_lamps() -> Lamps:
    """Two dashed lines of lamps in the floor that lead to the gate."""
    y = np.arange(-1.0, LENGTH - 3, 1.1)
    x = np.repeat([-1.75, 1.65], len(y))
    corner = np.stack([x, np.tile(y, 2), np.full_like(x, 0.012)], -1)
    one = np.ones((len(x), 1))
    return Lamps(corner, one * (0.1, 0, 0), one * (0, 0.6, 0), np.full(len(x), CYAN))

"""Lamps: where the small lights of the hall sit, and which of four colours each one has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlbench.scenes.shapes import Shape, quads

WIDTH, LENGTH, HEIGHT = 7.0, 34.0, 7.0  # half width; metres
CYAN, AMBER, ROSE, WHITE = range(4)  # the colours, as indices of RADIANCE
RADIANCE = ((0.10, 0.62, 0.85), (0.85, 0.36, 0.05), (0.85, 0.07, 0.30), (0.55, 0.60, 0.66))


class Lamps(NamedTuple):
    """Flat rectangles that shine to the side of across x up."""

    corner: NDArray[np.float64]  # n 3
    across: NDArray[np.float64]  # n 3
    up: NDArray[np.float64]  # n 3
    colour: NDArray[np.int64]  # n, into RADIANCE


def fixed(random: np.random.Generator) -> Lamps:
    """All lamps that are part of the building."""
    groups = [_strips(random), _signs(random), _gate(), _guides()]
    return joined(groups)


def joined(groups: Sequence[Lamps]) -> Lamps:
    """One table of lamps out of many."""
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def tubes() -> Shape:
    """Two lines of long tubes below the ceiling, between the beams: most of the light is theirs."""
    bays = np.arange(3.0, LENGTH, 4.0)
    corner = [(x - 0.25, y - 1.7, HEIGHT - 0.62) for y in bays for x in (-2.2, 2.2)]
    return quads(corner, (0, 3.4, 0), (0.5, 0, 0), tile=0)


def _strips(random: np.random.Generator) -> Lamps:
    """Two broken lines of small lamps along each long wall, cyan below and rose above."""
    y = np.arange(-3.5, LENGTH - 0.5, 0.3)
    groups = []
    for side in (-1.0, 1.0):
        for height, colour in ((0.93, CYAN), (3.34, ROSE if side < 0 else AMBER)):
            keep = y[random.random(len(y)) < 0.85]
            depth = WIDTH - (1.11 if height < 1 else 0.91)
            x = np.full_like(keep, side * depth)
            corner = np.stack([x, keep + (0.22 if side > 0 else 0), np.full_like(keep, height)], -1)
            length = random.uniform(0.12, 0.27, (len(keep), 1))
            up = np.array([[0, 0, 0.12]]).repeat(len(keep), 0)
            across = length * (0, -side, 0)
            groups.append(Lamps(corner, across, up, np.full(len(keep), colour)))
    return joined(groups)


def _signs(random: np.random.Generator) -> Lamps:
    """Panels of tiny lamps on the walls, like consoles and signs, in random colours and sizes."""
    groups = []
    for number, y in enumerate(np.arange(3.0, 27.0, 4.0)):
        side = 1.0 if number % 2 else -1.0
        rows, columns = np.meshgrid(np.arange(6), np.arange(12), indexing="ij")
        z = 1.5 + 0.2 * rows.ravel()
        along = y - 1.2 + 0.2 * columns.ravel() + (0.16 if side > 0 else 0)
        corner = np.stack([np.full_like(z, side * (WIDTH - 0.02)), along, z], -1)
        size = random.choice([0.04, 0.08, 0.14], (len(z), 1))
        colour = random.integers(4, size=len(z))
        across, up = size * np.array([0, -1.15 * side, 0]), size * np.array([0, 0, 1.0])
        groups.append(Lamps(corner, across, up, colour))
    return joined(groups)


def _gate() -> Lamps:
    """A ring of lamps about the round gate at the far end."""
    angle = np.arange(48) * (2 * np.pi / 48)
    outward = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
    along = np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], -1)
    corner = np.array([0, LENGTH - 1.35, 2.9]) + 2.2 * outward - 0.12 * along
    return Lamps(corner, 0.24 * along, 0.22 * outward, np.full(48, AMBER))


def _guides() -> Lamps:
    """Two dashed lines let into the floor that lead to the gate."""
    y = np.arange(-1.0, LENGTH - 3, 1.1)
    x = np.repeat([-1.75, 1.65], len(y))
    corner = np.stack([x, np.tile(y, 2), np.full_like(x, 0.012)], -1)
    one = np.ones((len(x), 1))
    return Lamps(corner, one * (0.1, 0, 0), one * (0, 0.6, 0), np.full(len(x), CYAN))

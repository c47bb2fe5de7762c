"""Lamps: where the small lights of the hall sit, and how bright each one is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WIDTH, LENGTH, HEIGHT = 7.0, 34.0, 7.0  # half width; metres
CYAN, AMBER, ROSE, WHITE = (
    (0.12, 0.75, 1.0),
    (1.0, 0.42, 0.06),
    (1.0, 0.08, 0.35),
    (0.85, 0.92, 1.0),
)


class Lamps(NamedTuple):
    """Flat rectangles that shine to the side of across x up."""

    corner: NDArray[np.float64]  # n 3
    across: NDArray[np.float64]  # n 3
    up: NDArray[np.float64]  # n 3
    radiance: NDArray[np.float64]  # n 3


def fixed(random: np.random.Generator) -> Lamps:
    """All lamps that are part of the building."""
    groups = [_strips(random), _ceiling(random), _signs(random), _gate(), _guides()]
    return joined(groups)


def joined(groups: Sequence[Lamps]) -> Lamps:
    """One table of lamps out of many."""
    return Lamps(*(np.concatenate(column) for column in zip(*groups, strict=True)))


def _strips(random: np.random.Generator) -> Lamps:
    """Two broken lines of small lamps along each long wall, cyan below and rose above."""
    y = np.arange(-3.5, LENGTH - 0.5, 0.3)
    groups = []
    for side in (-1.0, 1.0):
        for height, colour, power in ((0.93, CYAN, 4.0), (3.34, ROSE if side < 0 else AMBER, 3.5)):
            keep = y[random.random(len(y)) < 0.85]
            depth = WIDTH - (1.11 if height < 1 else 0.91)
            x = np.full_like(keep, side * depth)
            corner = np.stack([x, keep + (0.22 if side > 0 else 0), np.full_like(keep, height)], -1)
            across = np.array([[0, -0.22 * side, 0]]).repeat(len(keep), 0)
            up = np.array([[0, 0, 0.12]]).repeat(len(keep), 0)
            shade = random.uniform(0.4, 1.6, (len(keep), 1))
            groups.append(Lamps(corner, across, up, power * shade * np.array(colour)))
    return joined(groups)


def _ceiling(random: np.random.Generator) -> Lamps:
    """White panels between the beams, many of them dead."""
    spots = [(x, y) for y in np.arange(3.0, LENGTH, 4.0) for x in (-2.4, 0.0, 2.4)]
    at = np.array([(x, y, HEIGHT - 0.65) for x, y in spots])
    shade = np.where(random.random(len(at)) < 0.6, 1.0, 0.08)[:, None]
    one = np.ones((len(at), 1))
    return Lamps(
        at - (0.35, 0.08, 0), one * (0, 0.16, 0), one * (0.7, 0, 0), 8 * shade * np.array(WHITE)
    )


def _signs(random: np.random.Generator) -> Lamps:
    """Panels of tiny lamps on the walls, like consoles and signs, in random colours."""
    groups = []
    for number, y in enumerate(np.arange(3.0, 27.0, 4.0)):
        side = 1.0 if number % 2 else -1.0
        rows, columns = np.meshgrid(np.arange(6), np.arange(12), indexing="ij")
        z = 1.5 + 0.2 * rows.ravel()
        along = y - 1.2 + 0.2 * columns.ravel() + (0.16 if side > 0 else 0)
        corner = np.stack([np.full_like(z, side * (WIDTH - 0.02)), along, z], -1)
        one = np.ones((len(z), 1))
        colour = np.array([CYAN, AMBER, ROSE, WHITE])[random.integers(4, size=len(z))]
        shade = random.choice([0.0, 0.4, 1.2, 3.0], (len(z), 1))
        groups.append(Lamps(corner, one * (0, -0.16 * side, 0), one * (0, 0, 0.14), shade * colour))
    return joined(groups)


def _gate() -> Lamps:
    """A ring of lamps about the round gate at the far end."""
    angle = np.arange(48) * (2 * np.pi / 48)
    outward = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
    along = np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], -1)
    corner = np.array([0, LENGTH - 1.35, 2.9]) + 2.2 * outward - 0.12 * along
    return Lamps(corner, 0.24 * along, 0.22 * outward, np.full((48, 1), 9.0) * np.array(AMBER))


def _guides() -> Lamps:
    """Two dashed lines let into the floor that lead to the gate."""
    y = np.arange(-1.0, LENGTH - 3, 1.1)
    x = np.repeat([-1.75, 1.65], len(y))
    corner = np.stack([x, np.tile(y, 2), np.full_like(x, 0.012)], -1)
    one = np.ones((len(x), 1))
    return Lamps(corner, one * (0.1, 0, 0), one * (0, 0.6, 0), one * 1.2 * np.array(CYAN))

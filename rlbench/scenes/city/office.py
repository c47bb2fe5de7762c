"""Office: a round tower of slightly tilted glass panes between metal floors and mullions."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.parts.primitives import lathe, quads
from rlbench.scenes.parts.shape import Shape, merge, transform

RADIUS, STOREY_HEIGHT, STOREY_COUNT = 7.5, 3.4, 7  # metres, metres, count
PANES_PER_STOREY = 44  # around the tower
LOBBY_HEIGHT = 4.4  # metres: height of the ground floor


def build_panes(random: np.random.Generator, x: float, y: float) -> Shape:
    """Glass quads around the axis (x, y), each tilted by a random fraction of a degree.

    The texture stretches over each pane.
    """
    angle = np.arange(PANES_PER_STOREY) * (2 * np.pi / PANES_PER_STOREY)
    low = np.concatenate([[0.15], LOBBY_HEIGHT + STOREY_HEIGHT * np.arange(STOREY_COUNT)])
    high = np.concatenate(
        [[LOBBY_HEIGHT], LOBBY_HEIGHT + STOREY_HEIGHT * (np.arange(STOREY_COUNT) + 1)]
    )
    a, bottom = (grid.ravel() for grid in np.meshgrid(angle, low))
    _, top = (grid.ravel() for grid in np.meshgrid(angle, high))
    start = np.stack([x + RADIUS * np.cos(a), y + RADIUS * np.sin(a), bottom], -1)
    b = a + 2 * np.pi / PANES_PER_STOREY
    end = np.stack([x + RADIUS * np.cos(b), y + RADIUS * np.sin(b), bottom], -1)
    up = np.stack([np.zeros_like(a), np.zeros_like(a), top - bottom], -1)
    out = np.stack(
        [np.cos(a + np.pi / PANES_PER_STOREY), np.sin(a + np.pi / PANES_PER_STOREY), 0 * a], -1
    )
    lean = random.normal(0, 0.005, (len(a), 1)) * out  # metres per metre
    skew = random.normal(0, 0.008, (len(a), 1)) * out
    return quads(start, end - start + skew, up + lean * up[:, 2:], tile_size=0)


def build_frame(x: float, y: float) -> Shape:
    """Mullions between the panes, a band at each floor, and a crown, around the axis (x, y)."""
    angle = np.arange(PANES_PER_STOREY) * (2 * np.pi / PANES_PER_STOREY)
    top = LOBBY_HEIGHT + STOREY_HEIGHT * STOREY_COUNT
    width, depth = 0.05, 0.16
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    side = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], -1)
    foot = np.array([x, y, 0.0]) + (RADIUS - 0.03) * out
    rise = np.array([0, 0, top])
    mullions = [
        quads(foot + depth * out - width * side, 2 * width * side, rise),
        quads(foot - width * side, depth * out, rise),
        quads(foot + depth * out + width * side, -depth * out, rise),
    ]
    bands = [
        lathe(
            [
                (RADIUS, z - 0.16),
                (RADIUS + 0.12, z - 0.16),
                (RADIUS + 0.12, z + 0.16),
                (RADIUS, z + 0.16),
            ],
            PANES_PER_STOREY,
        )
        for z in LOBBY_HEIGHT + STOREY_HEIGHT * np.arange(STOREY_COUNT + 1)
    ]
    eaves = RADIUS + 0.9
    crown = lathe(
        [(RADIUS + 0.1, top), (eaves, top + 0.35), (eaves, top + 0.6), (0.5, top + 0.8)],
        PANES_PER_STOREY,
    )
    return merge(*mullions, *(transform(part, (x, y, 0)) for part in (*bands, crown)))

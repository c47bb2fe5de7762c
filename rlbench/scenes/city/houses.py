"""Houses: fronts with shops, windows, shutters, awnings, roofs and chimneys."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.city.windows import ATLAS_CELLS, show_atlas_cells
from rlbench.scenes.parts.primitives import boxes, quads
from rlbench.scenes.parts.shape import Float32Array, Shape, merge, paint

STOREY_HEIGHT, BAY_WIDTH = 3.1, 2.4  # metres: height of a storey, width of a window bay
HOUSE_COLOURS = (
    (0.06, 0.16, 0.12),  # 0 shutters
    (0.05, 0.10, 0.22),
    (0.30, 0.05, 0.04),
    (0.045, 0.05, 0.06),  # 3 slate
    (0.14, 0.08, 0.05),  # 4 bark and wood
    (0.52, 0.10, 0.07),  # 5 awnings
    (0.74, 0.70, 0.62),
    (0.07, 0.21, 0.24),
    (0.025, 0.03, 0.03),  # 8 iron
    (0.62, 0.10, 0.16),  # 9 flowers and fruit
    (0.80, 0.56, 0.12),
    (0.09, 0.19, 0.04),  # 11 leaves
    (0.26, 0.15, 0.075),  # 12 light wood
)


def build_house(random: np.random.Generator, bays: int, storeys: int) -> dict[str, Shape]:
    """A house front from x = 0 that faces -y, as shapes by material.

    It has shops on the ground floor, storeys of windows above, a cornice and a slate roof.
    """
    width, shop, depth = bays * BAY_WIDTH, 3.9, 0.32
    top = shop + storeys * STOREY_HEIGHT
    middles = BAY_WIDTH * (np.arange(bays) + 0.5)
    x, z = (
        grid.ravel() for grid in np.meshgrid(middles, shop + STOREY_HEIGHT * np.arange(storeys))
    )
    half = 0.55  # half a window's width, metres
    level, wall_z = np.zeros_like(x), np.zeros(bays + 1)

    edges = np.concatenate([[0.0], middles + half]), np.concatenate([middles - half, [width]])
    piers = boxes(
        np.stack([edges[0], wall_z, wall_z + shop], -1),
        np.stack([edges[1], wall_z + depth, wall_z + top], -1),
        tile_size=2.0,
    )
    sill, head = z + 0.75, z + 2.55
    below = boxes(
        np.stack([x - half, level, z], -1),
        np.stack([x + half, level + depth, sill], -1),
        tile_size=2.0,
    )
    above = boxes(
        np.stack([x - half, level, head], -1),
        np.stack([x + half, level + depth, z + STOREY_HEIGHT], -1),
        tile_size=2.0,
    )
    body = boxes((0, depth + 0.1, 0), (width, 9, top), tile_size=2.0)

    sills = boxes(
        np.stack([x - 0.72, level - 0.14, sill - 0.1], -1),
        np.stack([x + 0.72, level + depth, sill], -1),
    )
    bars = boxes(
        np.stack([x - 0.03, level + 0.2, sill], -1), np.stack([x + 0.03, level + 0.3, head], -1)
    )
    bands = boxes(
        [(0, -0.1, shop - 0.35), (0, -0.45, top - 0.1), (0, -0.25, top - 0.4)],
        [(width, 0.35, shop), (width, depth, top + 0.25), (width, depth, top)],
    )
    posts = boxes(
        np.stack([BAY_WIDTH * np.arange(bays + 1) - 0.18, wall_z - 0.05, wall_z], -1).clip(
            (0, -9, 0), None
        ),
        np.stack([BAY_WIDTH * np.arange(bays + 1) + 0.18, wall_z + 0.3, wall_z + shop], -1).clip(
            None, (width, 9, 99)
        ),
    )
    glass = _build_panes(random, x, sill, head, middles, depth)
    return {
        "wall": merge(piers, below, above, body),
        "trim": merge(sills, bars, bands, posts),
        "glass": glass,
        "paint": merge(*_build_facade_details(random, x, sill, head, width, top)),
    }


def _build_panes(
    random: np.random.Generator,
    x: Float32Array,
    sill: Float32Array,
    head: Float32Array,
    doors: Float32Array,
    depth: float,
) -> Shape:
    """Window panes and shop fronts, each of which shows a cell of `window_atlas`."""
    half = 0.55
    low = np.stack([x - half, np.full_like(x, depth - 0.04), sill], -1)
    up = np.stack([np.zeros_like(x), random.normal(0, 0.004, len(x)), head - sill], -1)
    upper = quads(low, np.array([2 * half, 0, 0]) + random.normal(0, 0.004, (len(x), 3)), up, 0)
    front = np.stack([doors - BAY_WIDTH / 2, np.full_like(doors, depth - 0.04), 0 * doors], -1)
    lower = quads(front, (BAY_WIDTH, 0, 0), (0, 0, 3.6), tile_size=0)
    cells = np.concatenate(
        [
            random.integers(0, ATLAS_CELLS * (ATLAS_CELLS - 2), len(x)),
            random.integers(ATLAS_CELLS, size=len(doors)),
        ]
    )
    cells[len(x) :] += ATLAS_CELLS * (ATLAS_CELLS - 1)  # the last row shows shops
    return show_atlas_cells(merge(upper, lower), cells)


def _build_facade_details(
    random: np.random.Generator,
    x: Float32Array,
    sill: Float32Array,
    head: Float32Array,
    width: float,
    top: float,
) -> list[Shape]:
    """Shutters, a striped awning, the roof and three chimneys."""
    shutter_colour = random.integers(3)
    size = len(HOUSE_COLOURS)
    left = np.stack([x - 1.05, np.full_like(x, -0.07), sill], -1)
    leaf = np.stack([np.full_like(x, 0.48), np.full_like(x, 0.06), head - sill], -1)
    shutters = boxes(
        np.concatenate([left, left + (1.62, 0, 0)]),
        np.concatenate([left + leaf, left + leaf + (1.62, 0, 0)]),
    )
    stripes = np.arange(0.3, width - 0.5, 0.3)
    corner = np.stack([stripes, np.full_like(stripes, -1.3), np.full_like(stripes, 2.6)], -1)
    awning = quads(corner, (0.3, 0, 0), (0, 1.3, 0.75))
    colour = np.where(np.arange(len(stripes)) % 2, 6, random.choice([5, 7])).repeat(4)
    roof = quads((0, -0.3, top + 0.25), (width, 0, 0), (0, 1.9, 2.8))
    chimneys = random.uniform(0.8, width - 1.2, 3)
    low = np.stack([chimneys, np.full(3, 1.6), np.full(3, top)], -1)
    return [
        paint(shutters, shutter_colour, size),
        paint(awning, colour, size),
        paint(roof, 3, size),
        paint(boxes(low, low + (0.8, 0.6, 3.6)), 2, size),
    ]

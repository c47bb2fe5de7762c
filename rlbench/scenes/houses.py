"""Houses: fronts with shops, windows, shutters, awnings and roofs, part by part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlbench.scenes.shapes import Floats, Shape, boxes, merge, painted, quads
from rlbench.scenes.textures import Pixels

CELLS = 6  # of the atlas of windows, along each side
FLOOR, BAY = 3.1, 2.4  # metres: height of a storey, width of a window bay
PAINTS = (
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


def house(random: np.random.Generator, bays: int, floors: int) -> dict[str, Shape]:
    """A house front from x = 0 that faces -y: shop, storeys of windows, cornice and slate roof."""
    width, shop, depth = bays * BAY, 3.9, 0.32
    top = shop + floors * FLOOR
    middles = BAY * (np.arange(bays) + 0.5)
    x, z = (grid.ravel() for grid in np.meshgrid(middles, shop + FLOOR * np.arange(floors)))
    half = 0.55  # of a window, metres
    level, wall_z = np.zeros_like(x), np.zeros(bays + 1)

    edges = np.concatenate([[0.0], middles + half]), np.concatenate([middles - half, [width]])
    piers = boxes(
        np.stack([edges[0], wall_z, wall_z + shop], -1),
        np.stack([edges[1], wall_z + depth, wall_z + top], -1),
        tile=2.0,
    )
    sill, head = z + 0.75, z + 2.55
    below = boxes(
        np.stack([x - half, level, z], -1), np.stack([x + half, level + depth, sill], -1), tile=2.0
    )
    above = boxes(
        np.stack([x - half, level, head], -1),
        np.stack([x + half, level + depth, z + FLOOR], -1),
        tile=2.0,
    )
    body = boxes((0, depth + 0.1, 0), (width, 9, top), tile=2.0)

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
        np.stack([BAY * np.arange(bays + 1) - 0.18, wall_z - 0.05, wall_z], -1).clip(
            (0, -9, 0), None
        ),
        np.stack([BAY * np.arange(bays + 1) + 0.18, wall_z + 0.3, wall_z + shop], -1).clip(
            None, (width, 9, 99)
        ),
    )
    glass = _panes(random, x, sill, head, middles, depth)
    return {
        "wall": merge(piers, below, above, body),
        "trim": merge(sills, bars, bands, posts),
        "glass": glass,
        "paint": merge(*_dressing(random, x, sill, head, width, top)),
    }


def _panes(
    random: np.random.Generator, x: Floats, sill: Floats, head: Floats, doors: Floats, depth: float
) -> Shape:
    """Windows and shop fronts, each with a cell of the atlas `windows` behind its glass."""
    half = 0.55
    low = np.stack([x - half, np.full_like(x, depth - 0.04), sill], -1)
    tall = np.stack([np.zeros_like(x), random.normal(0, 0.004, len(x)), head - sill], -1)
    upper = quads(low, np.array([2 * half, 0, 0]) + random.normal(0, 0.004, (len(x), 3)), tall, 0)
    front = np.stack([doors - BAY / 2, np.full_like(doors, depth - 0.04), 0 * doors], -1)
    lower = quads(front, (BAY, 0, 0), (0, 0, 3.6), tile=0)
    cells = np.concatenate(
        [random.integers(0, CELLS * (CELLS - 2), len(x)), random.integers(CELLS, size=len(doors))]
    )
    cells[len(x) :] += CELLS * (CELLS - 1)  # shops have the last row
    return behind(merge(upper, lower), cells)


def behind(glass: Shape, cells: NDArray[np.int64]) -> Shape:
    """Panes, four vertices each, before cells of the atlas `windows`, which count row by row."""
    corner = np.stack([cells % CELLS, cells // CELLS], -1).repeat(4, 0)
    return glass._replace(uv=((corner + 0.02 + 0.96 * glass.uv) / CELLS).astype(np.float32))


def windows(random: np.random.Generator, size: int = 64) -> Pixels:
    """What is seen behind glass: CELLS x CELLS cells of curtains and rooms; last rows: offices, shops."""
    rows = []
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    kinds = [_room] * (CELLS - 2) + [_desk, _shop]
    for kind in kinds:
        rows.append(np.concatenate([kind(random, u, v) for _ in range(CELLS)], 1))
    return np.concatenate(rows).astype(np.float32)


def _room(random: np.random.Generator, u: Floats, v: Floats) -> Floats:
    """Curtains to both sides, perhaps a blind, before a dark room; v goes up."""
    room = np.full((*u.shape, 3), 0.012) + 0.02 * v[..., None]
    cloth = np.array([(0.60, 0.57, 0.50), (0.50, 0.30, 0.22), (0.35, 0.40, 0.42)])[
        random.integers(3)
    ]
    drawn = random.uniform(0.0, 0.42) + 0.06 * (1 - v) ** 2
    fold = 0.75 + 0.25 * np.sin(2 * np.pi * (14 * u + random.uniform()))
    curtain = (np.abs(u - 0.5) > 0.5 - drawn)[..., None]
    shaded = cloth * fold[..., None] * 0.7
    blind = (v > random.uniform(0.45, 1.6))[..., None]
    slats = (0.55 * (0.7 + 0.3 * np.sin(2 * np.pi * 24 * v)))[..., None] * np.array((0.9, 0.86, 0.78))
    return np.where(blind, slats, np.where(curtain, shaded, room))


def _desk(random: np.random.Generator, u: Floats, v: Floats) -> Floats:
    """An office: a ceiling with lamps above a dark blue depth, and perhaps a blind."""
    depth = np.array((0.012, 0.022, 0.028)) * (1 + v[..., None])
    lamps = (v > 0.86) & (np.abs(u * 2 % 1 - 0.5) < 0.3)
    ceiling = np.where(lamps[..., None], 0.5, np.where((v > 0.8)[..., None], 0.12, depth))
    blind = (v > random.uniform(0.55, 2.2))[..., None]
    return np.where(blind, 0.30 * (0.7 + 0.3 * np.sin(2 * np.pi * 24 * v))[..., None], ceiling)


def _shop(random: np.random.Generator, u: Floats, v: Floats) -> Floats:
    """A door frame, shelves of goods, and a sign above."""
    hue = np.array([(0.05, 0.14, 0.12), (0.20, 0.05, 0.05), (0.06, 0.08, 0.16), (0.16, 0.11, 0.05)])[
        random.integers(4)
    ]
    image = np.broadcast_to(np.array((0.10, 0.075, 0.05)) * (0.4 + 0.8 * v[..., None]), (*u.shape, 3))
    shelf, column = np.floor(v * 11).astype(int), np.floor(u * 13).astype(int)
    goods = random.uniform(0.04, 0.55, (11, 13, 3)) * random.uniform(0.3, 1, (11, 13, 1))
    tall = random.uniform(0.4, 0.9, (11, 13))
    shown = (v * 11 % 1 < tall[shelf, column]) & (u * 13 % 1 > 0.12) & (v > 0.16) & (v < 0.62)
    image = np.where(shown[..., None], goods[shelf, column], image)
    frame = (v < 0.14) | (v > 0.86) | (np.abs(u - 0.5) > 0.46) | (np.abs(u - 0.33) < 0.015)
    image = np.where(frame[..., None], hue, image)
    letters = (np.abs(v - 0.93) < 0.03) & (np.sin(61 * u) + np.sin(37 * u + 40 * hue[0]) > 0.1)
    return np.where((letters & (np.abs(u - 0.5) < 0.35))[..., None], (0.75, 0.62, 0.32), image)


def _dressing(
    random: np.random.Generator, x: Floats, sill: Floats, head: Floats, width: float, top: float
) -> list[Shape]:
    """Shutters, an awning above each shop window, the roof and its chimneys."""
    shut = random.integers(3)
    of = len(PAINTS)
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
    pots = random.uniform(0.8, width - 1.2, 3)
    low = np.stack([pots, np.full(3, 1.6), np.full(3, top)], -1)
    return [
        painted(shutters, shut, of),
        painted(awning, colour, of),
        painted(roof, 3, of),
        painted(boxes(low, low + (0.8, 0.6, 3.6)), 2, of),
    ]

"""Houses around the square with their windows, and a round office tower of tilted panes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlbench.apps.render.scenes.parts.materials import Pixels
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Float64Array,
    Shape,
    boxes,
    lathe,
    merge,
    paint,
    quads,
    transform,
)

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
ATLAS_CELLS = 6  # along each side of the atlas
CURTAIN_COLOURS = ((0.60, 0.57, 0.50), (0.50, 0.30, 0.22), (0.35, 0.40, 0.42))
SHOP_COLOURS = ((0.05, 0.14, 0.12), (0.20, 0.05, 0.05), (0.06, 0.08, 0.16), (0.16, 0.11, 0.05))
OFFICE_RADIUS, OFFICE_STOREY_HEIGHT, OFFICE_STOREY_COUNT = 7.5, 3.4, 7  # metres, metres, count
PANES_PER_STOREY = 44  # around the tower
LOBBY_HEIGHT = 4.4  # metres: height of the ground floor


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


def show_atlas_cells(glass: Shape, cells: NDArray[np.int64]) -> Shape:
    """The panes, four vertices each, textured with one cell of `window_atlas` each.

    Cells are numbered row by row.
    """
    corner = np.stack([cells % ATLAS_CELLS, cells // ATLAS_CELLS], -1).repeat(4, 0)
    return glass._replace(uv=((corner + 0.02 + 0.96 * glass.uv) / ATLAS_CELLS).astype(np.float32))


def window_atlas(random: np.random.Generator, size: int = 64) -> Pixels:
    """An atlas of ATLAS_CELLS x ATLAS_CELLS cells [h w 3], `size` texels each.

    The last two rows show offices and shops, the others rooms.
    """
    rows = []
    texel_centres = (np.arange(size) + 0.5) / size
    v, u = np.meshgrid(texel_centres, texel_centres, indexing="ij")
    draw_rows = [_room_cell] * (ATLAS_CELLS - 2) + [_office_cell, _shop_cell]
    for draw_cell in draw_rows:
        rows.append(np.concatenate([draw_cell(random, u, v) for _ in range(ATLAS_CELLS)], 1))
    return np.concatenate(rows).astype(np.float32)


def _room_cell(random: np.random.Generator, u: Float64Array, v: Float64Array) -> Float64Array:
    """A dark room behind curtains on both sides and perhaps a blind; v points up."""
    room = np.full((*u.shape, 3), 0.012) + 0.02 * v[..., None]
    cloth = np.array(CURTAIN_COLOURS)[random.integers(len(CURTAIN_COLOURS))]
    drawn = random.uniform(0.0, 0.42) + 0.06 * (1 - v) ** 2
    fold = 0.75 + 0.25 * np.sin(2 * np.pi * (14 * u + random.uniform()))
    curtain = (np.abs(u - 0.5) > 0.5 - drawn)[..., None]
    shaded = cloth * fold[..., None] * 0.7
    blind = (v > random.uniform(0.45, 1.6))[..., None]
    slats = _blind_slats(v) * np.array((0.50, 0.48, 0.43))
    return np.where(blind, slats, np.where(curtain, shaded, room))


def _office_cell(random: np.random.Generator, u: Float64Array, v: Float64Array) -> Float64Array:
    """A dark blue office under a ceiling with lamps, perhaps behind a blind."""
    depth = np.array((0.012, 0.022, 0.028)) * (1 + v[..., None])
    lamps = (v > 0.86) & (np.abs(u * 2 % 1 - 0.5) < 0.3)
    ceiling = np.where(lamps[..., None], 0.5, np.where((v > 0.8)[..., None], 0.12, depth))
    blind = (v > random.uniform(0.55, 2.2))[..., None]
    return np.where(blind, 0.30 * _blind_slats(v), ceiling)


def _shop_cell(random: np.random.Generator, u: Float64Array, v: Float64Array) -> Float64Array:
    """A shop front: a door frame, shelves of goods, and a sign above."""
    hue = np.array(SHOP_COLOURS)[random.integers(len(SHOP_COLOURS))]
    image = np.array((0.24, 0.18, 0.12)) * (0.4 + 0.8 * v[..., None])
    shelf, column = np.floor(v * 11).astype(int), np.floor(u * 13).astype(int)
    goods = random.uniform(0.1, 0.9, (11, 13, 3)) * random.uniform(0.4, 1, (11, 13, 1))
    heights = random.uniform(0.4, 0.9, (11, 13))
    is_goods = (v * 11 % 1 < heights[shelf, column]) & (u * 13 % 1 > 0.12) & (v > 0.16) & (v < 0.62)
    image = np.where(is_goods[..., None], goods[shelf, column], image)
    frame = (v < 0.14) | (v > 0.86) | (np.abs(u - 0.5) > 0.46) | (np.abs(u - 0.33) < 0.015)
    image = np.where(frame[..., None], hue, image)
    letters = (np.abs(v - 0.93) < 0.03) & (np.sin(61 * u) + np.sin(37 * u + 40 * hue[0]) > 0.1)
    return np.where((letters & (np.abs(u - 0.5) < 0.35))[..., None], (0.75, 0.62, 0.32), image)


def _blind_slats(v: Float64Array) -> Float64Array:
    return (0.7 + 0.3 * np.sin(2 * np.pi * 24 * v))[..., None]


def build_panes(random: np.random.Generator, x: float, y: float) -> Shape:
    """Glass quads around the axis (x, y), each tilted by a random fraction of a degree.

    The texture stretches over each pane.
    """
    angle = np.arange(PANES_PER_STOREY) * (2 * np.pi / PANES_PER_STOREY)
    low = np.concatenate(
        [[0.15], LOBBY_HEIGHT + OFFICE_STOREY_HEIGHT * np.arange(OFFICE_STOREY_COUNT)]
    )
    high = np.concatenate(
        [[LOBBY_HEIGHT], LOBBY_HEIGHT + OFFICE_STOREY_HEIGHT * (np.arange(OFFICE_STOREY_COUNT) + 1)]
    )
    a, bottom = (grid.ravel() for grid in np.meshgrid(angle, low))
    _, top = (grid.ravel() for grid in np.meshgrid(angle, high))
    start = np.stack([x + OFFICE_RADIUS * np.cos(a), y + OFFICE_RADIUS * np.sin(a), bottom], -1)
    b = a + 2 * np.pi / PANES_PER_STOREY
    end = np.stack([x + OFFICE_RADIUS * np.cos(b), y + OFFICE_RADIUS * np.sin(b), bottom], -1)
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
    top = LOBBY_HEIGHT + OFFICE_STOREY_HEIGHT * OFFICE_STOREY_COUNT
    width, depth = 0.05, 0.16
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    side = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], -1)
    foot = np.array([x, y, 0.0]) + (OFFICE_RADIUS - 0.03) * out
    rise = np.array([0, 0, top])
    mullions = [
        quads(foot + depth * out - width * side, 2 * width * side, rise),
        quads(foot - width * side, depth * out, rise),
        quads(foot + depth * out + width * side, -depth * out, rise),
    ]
    bands = [
        lathe(
            [
                (OFFICE_RADIUS, z - 0.16),
                (OFFICE_RADIUS + 0.12, z - 0.16),
                (OFFICE_RADIUS + 0.12, z + 0.16),
                (OFFICE_RADIUS, z + 0.16),
            ],
            PANES_PER_STOREY,
        )
        for z in LOBBY_HEIGHT + OFFICE_STOREY_HEIGHT * np.arange(OFFICE_STOREY_COUNT + 1)
    ]
    eaves = OFFICE_RADIUS + 0.9
    crown = lathe(
        [(OFFICE_RADIUS + 0.1, top), (eaves, top + 0.35), (eaves, top + 0.6), (0.5, top + 0.8)],
        PANES_PER_STOREY,
    )
    return merge(*mullions, *(transform(part, (x, y, 0)) for part in (*bands, crown)))

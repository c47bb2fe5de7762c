"""Windows: a texture atlas of rooms, offices and shops, shown on the panes of the city."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlbench.scenes.parts.shape import Float64Array, Shape
from rlbench.scenes.parts.textures import Pixels

ATLAS_CELLS = 6  # along each side of the atlas
CURTAIN_COLOURS = ((0.60, 0.57, 0.50), (0.50, 0.30, 0.22), (0.35, 0.40, 0.42))
SHOP_COLOURS = ((0.05, 0.14, 0.12), (0.20, 0.05, 0.05), (0.06, 0.08, 0.16), (0.16, 0.11, 0.05))


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

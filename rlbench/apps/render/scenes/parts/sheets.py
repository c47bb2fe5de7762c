"""Curved sheets: tori, arches, mouldings, leaf blades, pierced screens and block walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    grid_faces,
    merge,
    quads,
    to_shape,
)


def sheet(points: ArrayLike, tile_size: float = 1.0) -> Shape:
    """A grid of points [rows columns 3] as a sheet that faces along (row) x (column) direction.

    The texture repeats every `tile_size` metres, measured along the first column and first row.
    """
    at = np.asarray(points, float)
    rows, columns, _ = at.shape
    up = np.linalg.norm(np.diff(at[:, 0], axis=0, prepend=at[:1, 0]), axis=-1).cumsum()
    along = np.linalg.norm(np.diff(at[0], axis=0, prepend=at[0, :1]), axis=-1).cumsum()
    uv = np.stack(np.broadcast_arrays(along[None], up[:, None]), -1) / tile_size
    return to_shape(at, grid_faces(rows, columns), uv)


def torus(radius: float, tube_radius: float, sides: int = 64, tube_sides: int = 10) -> Shape:
    """A level torus about the origin."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    turn = np.linspace(0, 2 * np.pi, tube_sides + 1)[:, None]
    distance = radius + tube_radius * np.cos(turn)
    height = np.broadcast_to(tube_radius * np.sin(turn), (tube_sides + 1, sides + 1))
    return sheet(np.stack([distance * np.cos(angle), distance * np.sin(angle), height], -1))


def arch_wall(
    radius: float, half_width: float, spring_height: float, top: float, thickness: float
) -> Shape:
    """A wall from `spring_height` to `top` with a semicircular arch; lengths in metres.

    The wall spans x in [-half_width, half_width] and is `thickness` deep about y = 0.
    Its ends stay open.
    """
    a = _semicircle(radius, spring_height)
    low = np.concatenate([[(-half_width, spring_height)], a, [(half_width, spring_height)]])
    high = np.stack([low[:, 0], np.full(len(low), top)], -1)
    front = sheet(_at_depths([low, high], [-thickness / 2] * 2), 3.0)
    back = sheet(_at_depths([low[::-1], high[::-1]], [thickness / 2] * 2), 3.0)
    soffit = sheet(_at_depths([low, low], [thickness / 2, -thickness / 2]), 3.0)
    return merge(front, back, soffit)


def moulding(radius: float, width: float, spring_height: float, thickness: float) -> Shape:
    """The raised band around an arch of that radius; `thickness` exceeds that of the wall."""
    inner, outer = _semicircle(radius, spring_height), _semicircle(radius + width, spring_height)
    depths = [-thickness / 2, -thickness / 2, thickness / 2, thickness / 2, -thickness / 2]
    return sheet(_at_depths([inner, outer, outer, inner, inner], depths), 3.0)


def leaf_blade(
    length: float, width: float, rise: float, curl: float, steps: int = 7, cup: float = 0.2
) -> Shape:
    """A leaf that starts at the origin towards +x, inclined by `rise`, and bends down by `curl`.

    Angles are radians. The edges lie `cup` times the half width above the spine.
    """
    s = np.linspace(0, 1, steps)
    slope = rise - curl * s**1.5
    ahead = np.stack([np.cos(slope), np.sin(slope)], -1) * length / (steps - 1)
    spine = np.concatenate([[[0.0, 0.0]], ahead[:-1].cumsum(0)])
    half = width / 2 * (0.08 + 0.92 * np.sin(np.pi * (0.18 + 0.8 * s)) ** 0.8)
    side = np.array([-1.0, 0.0, 1.0])
    lift = cup * half[:, None] * np.abs(side)
    normal = np.stack([-np.sin(slope), np.cos(slope)], -1)
    x, z = (spine[:, None, k] + normal[:, None, k] * lift for k in (0, 1))
    return sheet(np.stack([x, half[:, None] * side, z], -1))


def pierced_screen(
    cells: tuple[int, int], cell_size: float, hole_radius: float, thickness: float
) -> Shape:
    """A screen of rows x columns square cells, each with a round hole, from the origin to +x, +z.

    It is `thickness` metres deep about y = 0 and has no back face: it is seen from the front only.
    """
    angle = np.linspace(0, 2 * np.pi, 17)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    square = circle / np.abs(circle).max(1, keepdims=True)
    inside, outside = hole_radius * circle, cell_size / 2 * square
    cell = sheet(
        _at_depths([outside, inside, inside], [-thickness / 2, -thickness / 2, thickness / 2])
    )
    rows, columns = np.indices(cells).reshape(2, -1)
    at = np.stack([(columns + 0.5) * cell_size, 0 * rows, (rows + 0.5) * cell_size], -1)
    count = len(cell.vertices)
    return Shape(
        (cell.vertices + at[:, None].astype(np.float32)).reshape(-1, 3),
        (cell.faces + (np.arange(len(at)) * count)[:, None, None]).reshape(-1, 3).astype(np.uint32),
        np.tile(cell.uv, (len(at), 1)),
    )


def block_wall(
    random: np.random.Generator,
    low: tuple[float, float],
    high: tuple[float, float],
    size: tuple[float, float] = (1.25, 0.6),
    gap: float = 0.018,
) -> Shape:
    """Front faces of blocks in running bond, over a rectangle of (x, z) near y = 0.

    Blocks are clipped at the edges of the rectangle. Each protrudes by 0 to 25 mm at random and
    shows a random part of the texture, which repeats every 3 metres.
    """
    clipped = [
        (max(x, low[0]), max(z, low[1]), min(x + size[0], high[0]), min(z + size[1], high[1]))
        for row, z in enumerate(np.arange(0, high[1], size[1]))
        for x in np.arange(-40 + size[0] / 2 * (row % 2), high[0], size[0])
    ]
    x0, z0, x1, z1 = np.array([c for c in clipped if c[2] - c[0] > 0.08 and c[3] - c[1] > 0.08]).T
    face = -random.uniform(0.0, 0.025, len(x0))
    width, height, zero = x1 - x0 - gap, z1 - z0 - gap, 0 * x0
    near = np.stack([x0 + gap / 2, face, z0 + gap / 2], -1)
    across, up = np.stack([width, zero, zero], -1), np.stack([zero, zero, height], -1)
    wall = quads(near, across, up, tile_size=3.0)
    shift = random.uniform(0, 1, (len(x0), 1, 2)).astype(np.float32)
    return wall._replace(uv=(wall.uv.reshape(-1, 4, 2) + shift).reshape(-1, 2))


def _semicircle(radius: float, spring_height: float, steps: int = 21) -> Float64Array:
    """Half a circle from left to right [steps 2] in (x, z)."""
    angle = np.linspace(np.pi, 0, steps)
    return np.stack([radius * np.cos(angle), spring_height + radius * np.sin(angle)], -1)


def _at_depths(outlines: list[Float64Array], depths: ArrayLike) -> Float64Array:
    """Outlines in (x, z), each at its own depth y, as points [outlines n 3]."""
    rows = zip(outlines, np.asarray(depths, float), strict=True)
    return np.stack([np.stack([o[:, 0], np.full(len(o), y), o[:, 1]], -1) for o, y in rows])

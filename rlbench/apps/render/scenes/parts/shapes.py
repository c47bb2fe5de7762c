"""Shapes: triangle meshes without material, how to merge and move them, and primitive ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rlbench.apps.render.scene import Mesh, MitsubaDict

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Point3 = tuple[float, float, float]  # x, y, z in metres


class Shape(NamedTuple):
    """Triangles without a material; faces are counter-clockwise seen from outside."""

    vertices: Float32Array  # v 3, metres, z up
    faces: NDArray[np.uint32]  # f 3
    uv: Float32Array  # v 2, in repeats of the texture

    def to_mesh(self, name: str, material: MitsubaDict, smooth: bool = False) -> Mesh:
        """The shape as a mesh with one material."""
        return Mesh(name, self.vertices, self.faces, material, uv=self.uv, smooth=smooth)


def merge(*shapes: Shape) -> Shape:
    """One shape with the triangles of all, in their order."""
    starts = np.cumsum([0] + [len(shape.vertices) for shape in shapes[:-1]])
    faces = [shape.faces + np.uint32(start) for shape, start in zip(shapes, starts, strict=True)]
    return Shape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate(faces),
        np.concatenate([shape.uv for shape in shapes]),
    )


def rotation_matrix(axis: ArrayLike, angle: float) -> Float32Array:
    """The 3x3 rotation by `angle` radians about `axis` (Rodrigues' formula)."""
    x, y, z = np.asarray(axis, np.float64) / np.linalg.norm(np.asarray(axis, np.float64))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return np.asarray(matrix, np.float32)


def yaw_matrix(angle: float) -> Float32Array:
    """The 3x3 rotation by `angle` radians about the vertical axis.

    >>> yaw_matrix(np.pi / 2).round(3) @ (1, 0, 0)
    array([0., 1., 0.])
    """
    return rotation_matrix((0, 0, 1), angle)


def transform(
    shape: Shape, translation: ArrayLike, rotation: Float32Array | None = None, scale: float = 1.0
) -> Shape:
    """The shape scaled, then rotated, then translated."""
    vertices = shape.vertices * np.float32(scale)
    if rotation is not None:
        vertices = vertices @ rotation.T
    return shape._replace(vertices=vertices + np.asarray(translation, np.float32))


def paint(shape: Shape, colour_index: ArrayLike, palette_size: int) -> Shape:
    """The shape with one colour of a palette texture, or with one colour for each vertex.

    `colour_index` is a number, or an array with one for each vertex, in [0, palette_size).
    """
    column = (np.broadcast_to(np.asarray(colour_index), len(shape.vertices)) + 0.5) / palette_size
    return shape._replace(uv=np.stack([column, np.full_like(column, 0.5)], -1).astype(np.float32))


def grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two triangles [f 3] for each cell of a grid of rows x columns vertices."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    a, b, c, d = first, first + 1, first + columns + 1, first + columns
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def to_shape(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike) -> Shape:
    """A shape from arrays of any leading shape; vertices [... 3], faces [... 3], uv [... 2]."""
    return Shape(
        np.asarray(vertices, np.float32).reshape(-1, 3),
        np.asarray(faces, np.uint32).reshape(-1, 3),
        np.asarray(uv, np.float32).reshape(-1, 2),
    )


def quads(corner: ArrayLike, across: ArrayLike, up: ArrayLike, tile_size: float = 1.0) -> Shape:
    """Parallelograms from arrays [n 3] or single vectors; they face along across x up.

    The texture repeats every `tile_size` metres from each corner. With tile_size = 0 it stretches
    over each parallelogram instead.
    """
    c, a, u = np.broadcast_arrays(
        *(np.atleast_2d(np.asarray(v, float)) for v in (corner, across, up))
    )
    vertices = np.stack([c, c + a, c + a + u, c + u], 1)
    extent = np.stack([np.linalg.norm(a, axis=1), np.linalg.norm(u, axis=1)], -1)  # n 2
    repeats = extent / tile_size if tile_size else np.ones_like(extent)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    faces = np.arange(len(c))[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
    return to_shape(vertices, faces, unit * repeats[:, None, :])


def boxes(low: ArrayLike, high: ArrayLike, tile_size: float = 1.0) -> Shape:
    """Axis-aligned boxes between two corners, arrays [n 3] or single vectors.

    The texture follows world space and repeats every `tile_size` metres, so that neighbours align.
    """
    low, high = np.broadcast_arrays(*(np.atleast_2d(np.asarray(v, float)) for v in (low, high)))
    sides = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3  # a x b points along +axis
        corners = np.stack([low, low, low, low], 1)  # n 4 3
        corners[:, 1:3, a] = high[:, None, a]
        corners[:, 2:4, b] = high[:, None, b]
        far = corners.copy()
        far[..., axis] = high[:, None, axis]
        flat = (b, a) if axis == 1 else (a, b)  # the texture is upright on every wall
        for side in (corners[:, ::-1], far):
            faces = np.arange(len(low))[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
            sides.append(to_shape(side, faces, side[..., flat] / tile_size))
    return merge(*sides)


def lathe(profile: Sequence[tuple[float, float]], sides: int = 32, flutes: int = 0) -> Shape:
    """A profile of (radius, height), from bottom to top, revolved about the vertical axis.

    The ends stay open. `flutes` is the number of shallow grooves along it, as on a column.
    """
    radius, height = np.array(profile, float).T
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    groove = 1 - 0.07 * np.abs(np.sin(angle * flutes / 2)) if flutes else np.ones_like(angle)
    ring = np.stack([np.cos(angle) * groove, np.sin(angle) * groove], -1)  # s 2
    wall = radius[:, None, None] * ring
    vertices = np.concatenate(
        [wall, np.broadcast_to(height[:, None, None], (*wall.shape[:2], 1))], -1
    )
    around = angle * radius.max()  # metres
    uv = np.stack(np.broadcast_arrays(around[None], height[:, None]), -1)
    return to_shape(vertices, grid_faces(len(radius), sides + 1), uv)


def disc(radius: float, height: float, sides: int = 32) -> Shape:
    """A disc that faces up."""
    angle = np.arange(sides) * (2 * np.pi / sides)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, height)], -1)
    vertices = np.concatenate([rim, [[0, 0, height]]])
    first = np.arange(sides)
    faces = np.stack([first, (first + 1) % sides, np.full(sides, sides)], -1)
    return to_shape(vertices, faces, vertices[:, :2])


def cylinder(radius: float, low: float, high: float, sides: int = 24) -> Shape:
    """An upright cylinder with both ends closed."""
    lid = disc(radius, high, sides)
    bottom = disc(radius, low, sides)
    return merge(
        lathe([(radius, low), (radius, high)], sides),
        lid,
        bottom._replace(faces=bottom.faces[:, ::-1]),
    )


def fluted_column(height: float, radius: float, sides: int = 72, flutes: int = 18) -> Shape:
    """A fluted column with base and capital that stands on the origin."""
    foot, head = 0.9 * radius, height - 1.1 * radius
    shaft = [(radius * (1 - 0.16 * s**1.6), foot + (head - foot) * s) for s in np.linspace(0, 1, 7)]
    torus = [
        (radius * (1.18 + 0.12 * np.sin(a)), radius * (0.66 - 0.22 * np.cos(a)))
        for a in np.linspace(0, np.pi, 7)
    ]
    bell = [(radius * (0.86 + 0.5 * s**2), head + radius * 0.62 * s) for s in np.linspace(0, 1, 6)]
    plinth, slab = 1.35 * radius, 1.45 * radius
    return merge(
        boxes((-plinth, -plinth, 0), (plinth, plinth, 0.44 * radius)),
        lathe(torus, 36),
        disc(1.18 * radius, foot - 0.02 * radius, 36),
        lathe(shaft, sides, flutes),
        lathe([(0.9 * radius, head - 0.1 * radius), (0.94 * radius, head), *bell[1:]], 36),
        boxes((-slab, -slab, head + 0.62 * radius), (slab, slab, height)),
    )


@cache
def icosphere(subdivisions: int = 3) -> Shape:
    """A sphere of radius one without seam or poles: an icosahedron, subdivided."""
    g = (1 + 5**0.5) / 2
    corners: list[tuple[float, float, float]] = [
        (-1, g, 0),
        (1, g, 0),
        (-1, -g, 0),
        (1, -g, 0),
        (0, -1, g),
        (0, 1, g),
    ]
    corners += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    vertices = np.array(corners, float)
    faces = np.array(
        [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11)]
        + [(1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8)]
        + [(3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9)]
        + [(4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    )
    for _ in range(subdivisions):
        edges = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1).reshape(-1, 2)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = index.reshape(-1, 3) + len(vertices)  # between corners 01, 12, 20
        vertices = np.concatenate([vertices, vertices[unique].mean(1)])
        (a, b, c), (ab, bc, ca) = faces.T, middle.T
        split = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(corner, -1) for corner in split])
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return to_shape(vertices, faces, np.zeros((len(vertices), 2)))


def grid(width: float, length: float, cells: tuple[int, int], tile_size: float = 1.0) -> Shape:
    """A level sheet about the origin, divided into cells, that faces up."""
    x = np.linspace(-width / 2, width / 2, cells[0] + 1)
    y = np.linspace(-length / 2, length / 2, cells[1] + 1)
    at = np.stack(np.meshgrid(x, y), -1)  # y x 2
    vertices = np.concatenate([at, np.zeros((*at.shape[:2], 1))], -1)
    return to_shape(vertices, grid_faces(cells[1] + 1, cells[0] + 1), at / tile_size)


def leaf_cloud(
    random: np.random.Generator, centres: ArrayLike, radius: float, size: float
) -> Shape:
    """Small quads in random orientations, each within `radius` of its centre, denser at the rim."""
    centres = np.asarray(centres, float)
    out = _random_directions(random, len(centres))
    across = _random_directions(random, len(centres))
    up = np.cross(across, out + 0.6 * _random_directions(random, len(centres)))
    up /= np.linalg.norm(up, axis=1, keepdims=True).clip(1e-6)
    scale = size * random.uniform(0.7, 1.3, (len(centres), 1))
    middle = centres + out * radius * random.uniform(0.1, 1, (len(centres), 1)) ** 0.4
    return quads(middle - scale * (across + up) / 2, across * scale, up * scale * 0.8, tile_size=0)


def _random_directions(random: np.random.Generator, count: int) -> Float64Array:
    vectors = random.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

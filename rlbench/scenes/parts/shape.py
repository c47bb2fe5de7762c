"""Shape: a triangle mesh without material; merge, transform and colour shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rlbench.render.scene import Mesh, MitsubaDict

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

"""Shapes for random scenes: closed solids, leaf clouds, walls with openings, waves over them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Shape(NamedTuple):
    """Triangles in metres, z up; texture coordinates run in metres along the surface."""

    vertices: Floats  # v 3
    faces: NDArray[np.int64]  # f 3, counter-clockwise from outside
    uv: Floats  # v 2


class Opening(NamedTuple):
    """A hole in a wall: from left to right along it, from low to high above its foot, metres."""

    left: float
    right: float
    low: float
    high: float


def quad(corners: ArrayLike) -> Shape:
    """One rectangle; its four corners run counter-clockwise as seen from its front."""
    points = np.asarray(corners, float)
    width, height = (np.linalg.norm(points[k] - points[0]) for k in (1, 3))
    uv = np.array([[0, 0], [width, 0], [width, height], [0, height]])
    return Shape(points, np.array([[0, 1, 2], [0, 2, 3]]), uv)


def box(x: float, y: float, z: float) -> Shape:
    """A cuboid of these sides; it stands on z = 0, centred."""
    a, b = x / 2, y / 2
    low = np.array([[-a, -b, 0], [a, -b, 0], [a, b, 0], [-a, b, 0]])
    high = low + [0, 0, z]
    sides = [quad([low[k], low[k - 3], high[k - 3], high[k]]) for k in range(4)]
    return merged([quad(low[::-1]), quad(high), *sides])


def lathe(profile: ArrayLike, segments: int = 28) -> Shape:
    """A solid of revolution about z; profile [p 2] is radius and height, from foot to top."""
    radius, height = np.asarray(profile, float).T
    angle = np.linspace(0, 2 * np.pi, segments + 1)[:, None]
    ring = [radius * np.cos(angle), radius * np.sin(angle), height + 0 * angle]
    length = np.hypot(np.diff(radius), np.diff(height)).sum()
    return _grid(np.stack(ring, -1), 2 * np.pi * radius.max(), length)


def sphere(radius: float, segments: int = 32) -> Shape:
    """A ball that touches z = 0 from above."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    waist = np.maximum(np.cos(angle), 0) * radius
    waist[[0, -1]] = 0
    return lathe(np.stack([waist, radius * (1 + np.sin(angle))], -1), segments)


def cylinder(radius: float, height: float, tip: float = 1.0, segments: int = 28) -> Shape:
    """A closed cylinder on z = 0; its top has `tip` times the radius of its foot."""
    side = lathe([[radius, 0], [radius * tip, height]], segments)
    foot = lathe([[0, 0], [radius, 0]], segments)
    top = lathe([[radius * tip, height], [0, height]], segments)
    return merged([side, foot, top])


def torus(ring: float, tube: float, segments: int = 36) -> Shape:
    """A ring that lies on z = 0; `ring` and `tube` are radii."""
    angle = np.linspace(0, 2 * np.pi, segments // 2 + 1)
    return lathe(np.stack([ring + tube * np.cos(angle), tube * (1 + np.sin(angle))], -1), segments)


def rod(start: ArrayLike, end: ArrayLike, radius: float) -> Shape:
    """A thin closed six-sided bar between two points."""
    foot, along = np.asarray(start, float), np.subtract(end, start)
    length = float(np.linalg.norm(along))
    axis = along / length
    side = np.cross(axis, [1, 0, 0] if abs(axis[0]) < 0.7 else [0, 1, 0])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis], -1)
    return moved(cylinder(radius, length, segments=6), foot, frame)


def sheet(x: float, y: float, cells: int) -> Shape:
    """A square grid in the plane z = 0, centred, facing up."""
    u, v = np.meshgrid(
        np.linspace(-x / 2, x / 2, cells + 1), np.linspace(-y / 2, y / 2, cells + 1), indexing="ij"
    )
    return _grid(np.stack([u, v, 0 * u], -1), x, y)


def leaves(rng: Generator, count: int, radii: ArrayLike, size: float) -> Shape:
    """Loose quads of side about `size`, any way round, in an ellipsoid about the origin."""
    centre = rng.normal(size=(count, 1, 3))
    centre /= np.linalg.norm(centre, axis=-1, keepdims=True)
    centre = centre * rng.uniform(0.1, 1, (count, 1, 1)) ** (1 / 2.2) * np.asarray(radii, float)
    frame = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    corner = np.array([[-1, -0.6], [1, -0.6], [1, 0.6], [-1, 0.6]]) / 2
    span = corner @ frame[:, :2] * size * rng.uniform(0.6, 1.4, (count, 1, 1))
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]
    return Shape((centre + span).reshape(-1, 3), faces.reshape(-1, 3), np.tile(corner, (count, 1)))


def wall(length: float, height: float, thick: float, openings: Sequence[Opening] = ()) -> Shape:
    """A wall along x, centred, its inner face in y = 0 and its body behind; openings by x."""
    pieces, left = [], -length / 2
    for hole in sorted(openings):
        pieces += [(left, hole.left, 0.0, height), (hole.left, hole.right, 0.0, hole.low)]
        pieces += [(hole.left, hole.right, hole.high, height)]
        left = hole.right
    pieces.append((left, length / 2, 0.0, height))
    return merged(
        [
            moved(box(b - a, thick, d - c), [(a + b) / 2, thick / 2, c])
            for a, b, c, d in pieces
            if b - a > 1e-6 and d - c > 1e-6
        ]
    )


def turn(angle: float, axis: int = 2) -> Floats:
    """Rotation [3 3] by an angle in radians about x, y or z (0, 1, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return matrix


def moved(shape: Shape, offset: ArrayLike = (0, 0, 0), rotation: Floats | None = None) -> Shape:
    """The shape rotated about the origin, then shifted."""
    vertices = shape.vertices if rotation is None else shape.vertices @ rotation.T
    return shape._replace(vertices=vertices + np.asarray(offset, float))


def merged(shapes: Sequence[Shape]) -> Shape:
    """All triangles in one shape."""
    start = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    return Shape(
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.faces + k for s, k in zip(shapes, start, strict=False)]),
        np.concatenate([s.uv for s in shapes]),
    )


def ripple(rng: Generator, count: int, length: float, height: float) -> Floats:
    """Random plane waves [count 5]: wave vector x y (rad per m), height (m), rad per frame, phase.

    Lengths spread by a factor of two about `length`; crests travel 1 to 4 % of it a frame.
    """
    angle, phase = rng.uniform(0, 2 * np.pi, (2, count))
    number = 2 * np.pi / (length * 2 ** rng.uniform(-1, 1, count))
    speed = 2 * np.pi * rng.uniform(0.01, 0.04, count)
    rows = [number * np.cos(angle), number * np.sin(angle), height / number, speed, phase]
    rows[2] = rows[2] / rows[2].sum() * height
    return np.stack(rows, -1)


def lift(waves: Floats, points: Floats, time: float) -> Floats:
    """Height of the waves above each point [v 2], metres; at most the sum of their heights."""
    angle = points @ waves[:, :2].T + waves[:, 3] * time + waves[:, 4]
    return np.asarray(np.sin(angle) @ waves[:, 2])


def _grid(points: Floats, width: float, height: float) -> Shape:
    """Faces between the points [n m 3] of a surface; triangles without area are left out."""
    n, m, _ = points.shape
    at = np.arange(n * m).reshape(n, m)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    vertices = points.reshape(-1, 3)
    p, q, r = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=-1)
    u, v = np.meshgrid(np.linspace(0, width, n), np.linspace(0, height, m), indexing="ij")
    return Shape(vertices, faces[area > 1e-12], np.stack([u, v], -1).reshape(-1, 2))

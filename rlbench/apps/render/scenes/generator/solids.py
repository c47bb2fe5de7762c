"""Random shapes: balls, drums, tori, crates, vases, stacks and foliage; walls with openings.

Solids stand on the origin; their `build_` functions take the random generator and a size in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    boxes,
    lathe,
    leaf_cloud,
    merge,
    rotation_matrix,
    transform,
    yaw_matrix,
)


def build_ball(rng: Generator, size: float) -> Shape:
    """A sphere, built by revolution so that textures wrap around it."""
    angle = np.linspace(0, np.pi, 17)
    return _revolve(0.4 * size * np.stack([np.sin(angle).round(6), 1 - np.cos(angle)], -1))


def build_drum(rng: Generator, size: float) -> Shape:
    """A cylinder, a truncated cone or a pointed cone."""
    height, tip_share = size * rng.uniform(0.3, 1.5), float(rng.choice([1, 0.6, 0.05]))
    rims = [(0, 0), (0.3 * size, 0), (0.3 * size * tip_share, height), (0, height)]
    return merge(*(_revolve(rims[k : k + 2]) for k in range(3)))  # separate, to keep rims sharp


def build_torus(rng: Generator, size: float) -> Shape:
    """A torus that lies flat or stands on its edge."""
    tube_radius, radius = size * rng.uniform(0.06, 0.16), 0.35 * size
    angle = np.linspace(0, 2 * np.pi, 21)
    flat = _revolve(
        np.stack([radius + tube_radius * np.cos(angle), tube_radius * (1 + np.sin(angle))], -1), 36
    )
    if rng.random() < 0.5:
        return flat
    return transform(
        flat, [0, tube_radius, radius + tube_radius], rotation_matrix((1, 0, 0), np.pi / 2)
    )


def build_crate(rng: Generator, size: float) -> Shape:
    """A box of random proportions."""
    return build_box(*(size * rng.uniform(0.3, 0.9, 3)))


def build_vase(rng: Generator, size: float) -> Shape:
    """A closed solid of revolution with a random smooth profile."""
    knots = 0.35 * size * rng.uniform(0.3, 1, 4)
    height = np.linspace(0, size * rng.uniform(0.7, 1.4), 25)
    radius = np.interp(height, np.linspace(0, height[-1], 4), knots)
    smooth = np.convolve(np.pad(radius, 3, "edge"), np.ones(7) / 7, "valid")
    return _revolve([[0, 0], *np.stack([smooth, height], -1), [0, height[-1]]])


def build_block_stack(rng: Generator, size: float) -> Shape:
    """Two to five blocks on top of each other, shifted and turned at random."""
    z, blocks = 0.0, []
    for _ in range(int(rng.integers(2, 6))):
        width, depth, rise = size * rng.uniform([0.3, 0.3, 0.15], [0.8, 0.8, 0.5])
        x, y, angle = rng.uniform(-1, 1, 3) * [0.06 * size, 0.06 * size, 0.5]
        blocks.append(transform(build_box(width, depth, rise), [x, y, z], yaw_matrix(angle)))
        z += rise
    return merge(*blocks)


def build_foliage(rng: Generator, count: int, radii: Float64Array, size: float) -> Shape:
    """Loose leaves about `size` metres wide, in an ellipsoid of `radii` [3] about the origin."""
    foliage = leaf_cloud(rng, np.zeros((count, 3)), 1.0, size / float(radii.mean()))
    return foliage._replace(vertices=foliage.vertices * radii.astype(np.float32))


def build_box(width: float, depth: float, height: float) -> Shape:
    """A box of the given extent along x, y and z, centred on the origin and standing on it."""
    return boxes([-width / 2, -depth / 2, 0], [width / 2, depth / 2, height])


def _revolve(profile: ArrayLike, sides: int = 32) -> Shape:
    """A solid of revolution without the degenerate triangles at its poles."""
    shape = lathe([(float(r), float(z)) for r, z in np.asarray(profile)], sides)
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 1e-12
    return shape._replace(faces=shape.faces[has_area])


SOLIDS = (build_ball, build_drum, build_torus, build_crate, build_vase, build_block_stack)


class Opening(NamedTuple):
    """A rectangular opening in a wall, in metres."""

    left: float  # along the wall, from its middle
    right: float
    low: float  # above the foot of the wall
    high: float


Openings = dict[int, list[Opening]]  # by wall: 0 north, 1 west, 2 south, 3 east, 4 roof


class Aperture(NamedTuple):
    """All openings of one wall, as the estimate of the mean radiance needs them."""

    outward: tuple[float, float, float]  # unit normal of the wall
    area: float  # m2, total


def opening_row(
    rng: Generator, length: float, width: float, spacing: float, height: float
) -> list[Opening]:
    """Equal openings along a wall, about `spacing` apart, in its upper part; all in metres."""
    count = max(1, int(length / (width + spacing)))
    low, high = height * rng.uniform(0.15, 0.4), height * rng.uniform(0.7, 0.93)
    centres = (np.arange(count) + 0.5) * length / count - length / 2
    return [Opening(x - width / 2, x + width / 2, low, high) for x in centres]


def build_walls(
    half: tuple[float, float], height: float, thickness: float, openings: Openings, has_roof: bool
) -> tuple[dict[str, Shape], tuple[Aperture, ...]]:
    """Floor and walls by part name, with or without a roof, and the apertures that admit light."""
    x, y = (2 * (side + thickness) for side in half)
    walls = []
    for k in range(4):
        wall = _build_wall((x, 2 * half[1])[k % 2], height, thickness, openings.get(k, []))
        walls.append(
            transform(transform(wall, [0, half[1 - k % 2], 0]), 0, yaw_matrix(k * np.pi / 2))
        )
    if has_roof:
        flat = _build_wall(x, y, 0.2, openings.get(4, []))
        walls.append(transform(flat, [0, y / 2, height], rotation_matrix((1, 0, 0), np.pi / 2)))
    apertures = []
    for k, row in openings.items():
        area = sum((one.right - one.left) * (one.high - one.low) for one in row)
        x_out, y_out = (0.0, 0.0) if k == 4 else yaw_matrix(k * np.pi / 2)[:2, 1]
        apertures.append(Aperture((float(x_out), float(y_out), float(k == 4)), float(area)))
    floor = boxes([-x / 2, -y / 2, -0.2], [x / 2, y / 2, 0])
    return {"floor": floor, "wall": merge(*walls)}, tuple(apertures)


def _build_wall(
    length: float, height: float, thickness: float, openings: Sequence[Opening]
) -> Shape:
    """A wall along x, centred on the origin, with its inner face at y = 0 and its body behind."""
    pieces, left = [], -length / 2
    for opening in sorted(openings):
        pieces += [
            (left, opening.left, 0.0, height),
            (opening.left, opening.right, 0.0, opening.low),
        ]
        pieces += [(opening.left, opening.right, opening.high, height)]
        left = opening.right
    a, b, c, d = np.array([*pieces, (left, length / 2, 0.0, height)]).T
    return boxes(np.stack([a, 0 * a, c], -1), np.stack([b, 0 * b + thickness, d], -1))

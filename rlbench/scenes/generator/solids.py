"""Random shapes that stand on the origin: balls, drums, tori, crates, vases, stacks, foliage.

Every `build_` function takes the random generator and a size in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from rlbench.scenes.parts.primitives import boxes, lathe, leaf_cloud
from rlbench.scenes.parts.shape import (
    Float64Array,
    Shape,
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

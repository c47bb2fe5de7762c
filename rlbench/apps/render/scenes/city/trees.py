"""Trees: trunks that fork into boughs and twigs, with folded leaves: thin, dense geometry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rlbench.apps.render.scenes.parts.shapes import Float32Array, Float64Array, Shape, merge, paint

LEAF_COLOURS = (
    (0.05, 0.14, 0.025),
    (0.07, 0.18, 0.03),
    (0.10, 0.23, 0.035),
    (0.14, 0.28, 0.04),
    (0.04, 0.12, 0.03),
    (0.22, 0.28, 0.05),
)


class Tree(NamedTuple):
    """Position and size of a tree, in metres."""

    x: float
    y: float
    height: float = 6.5
    crown_radius: float = 2.3
    leaf_count: int = 2600


class _Branch(NamedTuple):
    """A tapered piece of wood between two points."""

    start: Float64Array
    end: Float64Array
    start_radius: float  # metres
    end_radius: float


def build_trunks(trees: Sequence[Tree], seed: int = 5) -> Shape:
    """Trunks, boughs and twigs of `trees` as open tubes."""
    return merge(
        *(
            _build_tube(branch, 9 if branch.start_radius > 0.09 else 5)
            for number, tree in enumerate(trees)
            for branch in _grow_branches(tree, np.random.default_rng((seed, number)))
        )
    )


def build_leaves(trees: Sequence[Tree], palette_size: int, seed: int = 5) -> Shape:
    """Leaves of `trees`: two triangles each, folded along the rib, in palette colours 0 to 5."""
    return merge(
        *(
            _grow_leaves(
                tree,
                _grow_branches(tree, np.random.default_rng((seed, number))),
                palette_size,
                (seed, number, 1),
            )
            for number, tree in enumerate(trees)
        )
    )


def _grow_branches(tree: Tree, random: np.random.Generator) -> list[_Branch]:
    """Trunk, boughs and twigs of a tree; the last 42 are the twigs, which carry the leaves."""
    fork = 0.36 * tree.height
    foot = np.array([tree.x, tree.y, 0.0])
    lean = random.normal(0, 0.05, 3) * (tree.height, tree.height, 0)
    knee = foot + (0, 0, 0.5)
    crotch = foot + lean * 0.3 + (0, 0, fork)
    girth = 0.026 * tree.height
    parts = [
        _Branch(foot, knee, 1.6 * girth, 1.05 * girth),
        _Branch(knee, crotch, 1.05 * girth, 0.85 * girth),
    ]
    boughs, twigs = [], []
    for number in range(7):
        turn = 2.4 * number + random.uniform(-0.3, 0.3)
        rise = random.uniform(0.35, 0.75) if number else 1.3
        direction = np.array(
            [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)]
        )
        reach = (0.62 if number else 0.8) * np.array(
            [tree.crown_radius, tree.crown_radius, tree.height - fork]
        )
        end = crotch + direction * reach * random.uniform(0.85, 1.1)
        boughs.append(_Branch(crotch, end, 0.55 * girth, 0.22 * girth))
        for _ in range(6):
            share = random.uniform(0.45, 1.0)
            start = crotch + share * (end - crotch)
            out = direction + random.normal(0, 0.75, 3) + (0, 0, 0.25)
            length = random.uniform(0.25, 0.45) * tree.crown_radius
            tip = start + out / np.linalg.norm(out) * length
            tip[2] = max(tip[2], 0.8 * fork)
            twigs.append(_Branch(start, tip, 0.16 * girth, 0.05 * girth))
    return parts + boughs + twigs


def _grow_leaves(
    tree: Tree, branches: list[_Branch], palette_size: int, seed: tuple[int, ...]
) -> Shape:
    random = np.random.default_rng(seed)
    count = tree.leaf_count
    chosen = random.integers(len(branches) - 42, len(branches), count)  # a twig
    start = np.array([branch.start for branch in branches])[chosen]
    end = np.array([branch.end for branch in branches])[chosen]
    along = random.uniform(0.15, 1.1, (count, 1))
    offset = random.normal(size=(count, 3))
    offset *= (
        0.17
        * tree.crown_radius
        * random.uniform(0.1, 1, (count, 1))
        / np.linalg.norm(offset, axis=1, keepdims=True)
    )
    base = start + along * (end - start) + offset
    middle = np.array([tree.x, tree.y, 0.62 * tree.height])
    out = base - middle
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    rib = out + random.normal(0, 0.55, (count, 3)) - (0, 0, 0.45)  # outward and down
    rib /= np.linalg.norm(rib, axis=1, keepdims=True)
    side = np.cross(rib, out + random.normal(0, 0.4, (count, 3)) + (0, 0, 0.8))
    side /= np.linalg.norm(side, axis=1, keepdims=True).clip(1e-3)
    fold = np.cross(side, rib)
    length = random.uniform(0.19, 0.34, (count, 1)) * (tree.height / 6.5) ** 0.5
    waist, lift = base + 0.45 * length * rib, 0.08 * length * fold
    half_width = 0.36 * length * side
    corners = np.stack(
        [base, waist + half_width + lift, base + length * rib, waist - half_width + lift],
        1,
    )
    faces = np.arange(count)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
    shape = Shape(
        corners.reshape(-1, 3).astype(np.float32),
        faces.reshape(-1, 3).astype(np.uint32),
        np.zeros((4 * count, 2), np.float32),
    )
    # outer leaves are lighter, as they get more light
    lightness = 2.2 * (along[:, 0] - 0.4) + random.normal(0.6, 0.9, count)
    colour = np.clip(np.round(lightness + 1), 0, 3).astype(int)
    lot = random.uniform(size=count)
    colour = np.where(lot < 0.12, 4, np.where(lot > 0.94, 5, colour))
    return paint(shape, colour.repeat(4), palette_size)


def wind_response(shape: Shape, base_height: float = 2.0, ramp_height: float = 4.0) -> Float32Array:
    """Share of the wind's push that each vertex follows, in [0.2, 1]; it rises with height."""
    return np.asarray(
        np.clip((shape.vertices[:, 2] - base_height) / ramp_height, 0.2, 1), np.float32
    )


def _build_tube(branch: _Branch, sides: int) -> Shape:
    """An open, tapered tube that faces outward."""
    axis = branch.end - branch.start
    length = float(np.linalg.norm(axis))
    across = np.cross(axis, (0.3, 1.0, 0.2))
    across /= np.linalg.norm(across)
    other = np.cross(axis / length, across)
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    vertices = np.concatenate(
        [branch.start + branch.start_radius * ring, branch.end + branch.end_radius * ring]
    )
    first = np.arange(sides)
    up = first + sides + 1
    faces = np.concatenate(
        [np.stack([first, first + 1, up + 1], -1), np.stack([first, up + 1, up], -1)]
    )
    uv = np.stack([np.tile(angle / np.pi, 2), np.repeat([0, 2 * length], sides + 1)], -1)
    return Shape(vertices.astype(np.float32), faces.astype(np.uint32), uv.astype(np.float32))

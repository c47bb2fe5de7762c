"""Trees: trunks that fork into boughs and twigs, and folded leaves in the wind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rlbench.scenes.parts.shape import Float32Array, Float64Array, Shape, merge, paint

LEAF_COLOURS = (
    (0.05, 0.14, 0.025),
    (0.07, 0.18, 0.03),
    (0.10, 0.23, 0.035),
    (0.14, 0.28, 0.04),
    (0.04, 0.12, 0.03),
    (0.22, 0.28, 0.05),
)


class Tree(NamedTuple):
    """Where a tree stands and how it is built, in metres."""

    x: float
    y: float
    height: float = 6.5
    crown_radius: float = 2.3  # radius of the crown
    leaf_count: int = 2600


class _Branch(NamedTuple):
    """A tapered piece of wood between two points."""

    start: Float64Array
    end: Float64Array
    start_radius: float  # metres: radius at the start
    end_radius: float


def build_trunks(trees: Sequence[Tree], seed: int = 5) -> Shape:
    """The trunks and boughs of `trees`, open tubes; texture runs along them."""
    return merge(
        *(
            _build_tube(twig, 9 if twig.start_radius > 0.09 else 5)
            for number, tree in enumerate(trees)
            for twig in _grow_branches(tree, np.random.default_rng((seed, number)))
        )
    )


def build_leaves(trees: Sequence[Tree], palette_size: int, seed: int = 5) -> Shape:
    """The leaves of `trees`, each two triangles folded along its rib, in slots 0 .. 5 of `of`."""
    return merge(
        *(
            _grow_leaves(
                tree,
                _grow_branches(tree, np.random.default_rng((seed, n))),
                palette_size,
                (seed, n, 1),
            )
            for n, tree in enumerate(trees)
        )
    )


def _grow_branches(tree: Tree, random: np.random.Generator) -> list[_Branch]:
    """Trunk, boughs and twigs of a tree; the twigs, which carry the leaves, come last."""
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
        ahead = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
        reach = (0.62 if number else 0.8) * np.array(
            [tree.crown_radius, tree.crown_radius, tree.height - fork]
        )
        end = crotch + ahead * reach * random.uniform(0.85, 1.1)
        boughs.append(_Branch(crotch, end, 0.55 * girth, 0.22 * girth))
        for _ in range(6):
            share = random.uniform(0.45, 1.0)
            start = crotch + share * (end - crotch)
            out = ahead + random.normal(0, 0.75, 3) + (0, 0, 0.25)
            length = random.uniform(0.25, 0.45) * tree.crown_radius
            tip = start + out / np.linalg.norm(out) * length
            tip[2] = max(tip[2], 0.8 * fork)
            twigs.append(_Branch(start, tip, 0.16 * girth, 0.05 * girth))
    return parts + boughs + twigs


def _grow_leaves(
    tree: Tree, twigs: list[_Branch], palette_size: int, seed: tuple[int, ...]
) -> Shape:
    random = np.random.default_rng(seed)
    count = tree.leaf_count
    chosen = random.integers(len(twigs) - 42, len(twigs), count)  # the last 42 are twigs
    start = np.array([twig.start for twig in twigs])[chosen]
    end = np.array([twig.end for twig in twigs])[chosen]
    along = random.uniform(0.15, 1.1, (count, 1))
    away = random.normal(size=(count, 3))
    away *= (
        0.17
        * tree.crown_radius
        * random.uniform(0.1, 1, (count, 1))
        / np.linalg.norm(away, axis=1, keepdims=True)
    )
    base = start + along * (end - start) + away
    middle = np.array([tree.x, tree.y, 0.62 * tree.height])
    out = base - middle
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    rib = out + random.normal(0, 0.55, (count, 3)) - (0, 0, 0.45)  # leaves hang outward
    rib /= np.linalg.norm(rib, axis=1, keepdims=True)
    side = np.cross(rib, out + random.normal(0, 0.4, (count, 3)) + (0, 0, 0.8))
    side /= np.linalg.norm(side, axis=1, keepdims=True).clip(1e-3)
    fold = np.cross(side, rib)
    long = random.uniform(0.19, 0.34, (count, 1)) * (tree.height / 6.5) ** 0.5
    waist, lift = base + 0.45 * long * rib, 0.08 * long * fold
    wide = 0.36 * long * side
    corners = np.stack(
        [base, waist + wide + lift, base + long * rib, waist - wide + lift],
        1,
    )
    faces = np.arange(count)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
    shape = Shape(
        corners.reshape(-1, 3).astype(np.float32),
        faces.reshape(-1, 3).astype(np.uint32),
        np.zeros((4 * count, 2), np.float32),
    )
    # lit, outer leaves are the lighter ones
    lightness = 2.2 * (along[:, 0] - 0.4) + random.normal(0.6, 0.9, count)
    slot = np.clip(np.round(lightness + 1), 0, 3).astype(int)
    odd = random.uniform(size=count)
    slot = np.where(odd < 0.12, 4, np.where(odd > 0.94, 5, slot))
    return paint(shape, slot.repeat(4), palette_size)


def wind_response(shape: Shape, base_height: float = 2.0, ramp_height: float = 4.0) -> Float32Array:
    """How far the wind may push each vertex of leaves, 0.2..1: more with height."""
    return np.asarray(
        np.clip((shape.vertices[:, 2] - base_height) / ramp_height, 0.2, 1), np.float32
    )


def _build_tube(twig: _Branch, sides: int) -> Shape:
    """An open, tapered tube; faces outward."""
    axis = twig.end - twig.start
    length = float(np.linalg.norm(axis))
    across = np.cross(axis, (0.3, 1.0, 0.2))
    across /= np.linalg.norm(across)
    other = np.cross(axis / length, across)
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    vertices = np.concatenate(
        [twig.start + twig.start_radius * ring, twig.end + twig.end_radius * ring]
    )
    first = np.arange(sides)
    up = first + sides + 1
    faces = np.concatenate(
        [np.stack([first, first + 1, up + 1], -1), np.stack([first, up + 1, up], -1)]
    )
    uv = np.stack([np.tile(angle / np.pi, 2), np.repeat([0, 2 * length], sides + 1)], -1)
    return Shape(vertices.astype(np.float32), faces.astype(np.uint32), uv.astype(np.float32))

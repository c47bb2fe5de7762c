"""Car: a small old car, coloured by a palette, made of two outlines and four wheels."""

from __future__ import annotations

from functools import cache

import numpy as np

from rlbench.scenes.shapes import (
    Shape,
    boxes,
    cylinder,
    merge,
    painted,
    placed,
    quads,
    rotation,
)

BODY = ((0.50, 0.03, 0.03), (0.015, 0.02, 0.025), (0.02, 0.02, 0.02), (0.70, 0.68, 0.60))


@cache
def car() -> Shape:
    """The car about the origin, on the ground, facing +x."""
    hull = [(-2.0, 0.35), (2.05, 0.35), (2.1, 0.75), (1.9, 0.95), (0.95, 1.05), (0.45, 1.62)]
    hull += [(-1.05, 1.66), (-1.75, 1.05), (-2.1, 0.95)]
    pane = [(0.80, 1.07), (0.42, 1.52), (-0.25, 1.55), (-0.25, 1.07)]
    rear = [(-0.35, 1.07), (-0.35, 1.55), (-1.0, 1.55), (-1.5, 1.07)]
    of = len(BODY)
    parts = [painted(_extruded(hull, 0.85), 0, of)]
    parts += [painted(_extruded(window, 0.86), 1, of) for window in (pane, rear)]
    parts += [painted(quads((0.99, -0.7, 1.1), (0, 1.4, 0), (-0.46, 0, 0.5)), 1, of)]
    parts += [painted(quads((-1.70, 0.7, 1.15), (0, -1.4, 0), (0.56, 0, 0.48)), 1, of)]
    on_axle = rotation((1, 0, 0), np.pi / 2)
    for x in (-1.3, 1.35):
        for y in (-0.72, 0.9):
            parts.append(painted(placed(cylinder(0.36, 0, 0.2, 20), (x, y, 0.36), on_axle), 2, of))
            parts.append(
                painted(placed(cylinder(0.2, -0.01, 0.21, 16), (x, y, 0.36), on_axle), 3, of)
            )
    parts.append(
        painted(
            boxes(
                [(2.05, -0.85, 0.4), (-2.15, -0.85, 0.4)], [(2.2, 0.85, 0.52), (-2.0, 0.85, 0.52)]
            ),
            3,
            of,
        )
    )
    return merge(*parts)


def _extruded(outline: list[tuple[float, float]], half: float) -> Shape:
    """A convex outline in (x, z), counter-clockwise seen from -y, made 2 x half wide."""
    flat = np.array(outline)
    near = np.stack([flat[:, 0], np.full(len(flat), -half), flat[:, 1]], -1)
    sides = quads(near, np.roll(near, -1, 0) - near, (0, 2 * half, 0))
    sides = sides._replace(faces=sides.faces[:, ::-1])
    fan = np.array([(0, k, k + 1) for k in range(1, len(flat) - 1)], np.uint32)
    uv = np.zeros((len(flat), 2), np.float32)
    lid = Shape(near.astype(np.float32), fan, uv)
    other = Shape((near * (1, -1, 1)).astype(np.float32), fan[:, ::-1], uv)
    return merge(sides, lid, other)

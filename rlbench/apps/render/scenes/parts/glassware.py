"""Glassware: solid and hollow bodies whose surfaces are closed and face outward.

A path that enters glass through a hole would treat air as glass from there on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    disc,
    icosphere,
    lathe,
    merge,
    rotation_matrix,
    transform,
    yaw_matrix,
)

AXIS_RADIUS = 0.002  # metres: radius at which a disc closes a profile at the axis


def closed_lathe(profile: Sequence[tuple[float, float]], sides: int = 64) -> Shape:
    """A closed body from a profile of (radius, height) that starts and ends on the axis.

    The profile starts at the lower end and runs outward and up. If it returns down, the body is
    hollow.
    """
    first, last = profile[0], profile[-1]
    ring = lathe([(max(r, AXIS_RADIUS), z) for r, z in profile], sides)
    lid, bottom = disc(AXIS_RADIUS, last[1], sides), disc(AXIS_RADIUS, first[1], sides)
    return merge(ring, lid, bottom._replace(faces=bottom.faces[:, ::-1]))


def unmerge_vertices(shape: Shape) -> Shape:
    """The same faces without alongd vertices, so that smooth shading keeps them flat."""
    order = shape.faces.reshape(-1)
    faces = np.arange(len(order), dtype=np.uint32).reshape(-1, 3)
    return Shape(shape.vertices[order], faces, shape.uv[order])


def build_vase(height: float = 0.75, thickness: float = 0.022) -> Shape:
    """A hollow, bellied vase with a thick foot, open at the top."""
    along = np.linspace(0, 1, 40)
    belly = 0.11 + 0.13 * np.sin(np.pi * np.clip(along * 1.25, 0, 1)) ** 1.3
    belly = belly + 0.09 * np.clip(along - 0.72, 0, 1) ** 1.5 * 4
    outside = list(zip(belly, along * height, strict=True))
    inside = [(r - thickness, z) for r, z in outside if z > 0.09][::-1]
    lip = [(belly[-1] - thickness / 2, height + thickness / 3)]
    foot = [(0.0, 0.0), (0.06, 0.0)]
    return closed_lathe(foot + outside + lip + inside + [(0.06, 0.075), (0.0, 0.07)])


def build_crystal(height: float = 0.9, radius: float = 0.2) -> Shape:
    """A six-sided crystal with pointed ends and flat faces."""
    outline = [(0.5 * radius, 0.0), (radius, 0.14 * height), (0.9 * radius, 0.7 * height)]
    body = closed_lathe([(0.0, 0.0), *outline, (0.0, height)], 6)
    return unmerge_vertices(body)


def build_glass_on_plinths(plinths: Sequence[tuple[float, float, float, float]]) -> Shape:
    """A ball, crystals and a vase on three plinths: (x, y, radius, height of the top), metres."""
    ball, cluster, pedestal = plinths
    gap = 0.002  # metres above the stone
    crystals = merge(
        transform(build_crystal(), (0.0, 0.05, 0.0), yaw_matrix(0.4)),
        transform(
            build_crystal(0.62, 0.14), (0.27, -0.07, 0.01), rotation_matrix((0.3, 1, 0), 0.16)
        ),
        transform(
            build_crystal(0.45, 0.11), (-0.23, -0.12, 0.01), rotation_matrix((0.2, -1, 0), 0.2)
        ),
    )
    return merge(
        transform(icosphere(5), (ball[0], ball[1], ball[3] + 0.38 + gap), scale=0.38),
        transform(crystals, (cluster[0], cluster[1], cluster[3] + 0.05), scale=1.35),
        transform(build_vase(1.05, 0.03), (pedestal[0], pedestal[1], pedestal[3] + gap)),
    )

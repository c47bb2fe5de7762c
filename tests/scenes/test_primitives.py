"""Primitive shapes face outward and enclose their volume."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.scenes.parts import primitives


def _normals(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces].astype(np.float64), 1, 0)
    return np.cross(b - a, c - a)  # twice the area long


def _volume(shape):
    """Volume that the faces enclose, by the divergence theorem; negative if inside out."""
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    return (a * np.cross(b, c)).sum() / 6


@pytest.mark.parametrize(
    ("shape", "volume", "rel"),
    [
        (primitives.boxes((0, 0, 0), (1, 2, 3)), 6.0, 1e-6),
        (primitives.boxes([(0, 0, 0), (5, 5, 5)], [(1, 1, 1), (7, 6, 6)]), 3.0, 1e-6),
        (primitives.icosphere(4), 4 / 3 * np.pi, 0.01),  # the facets lie inside the ball
        (primitives.cylinder(0.5, 1.0, 3.0, 64), np.pi / 2, 0.01),
    ],
    ids=["box", "two boxes", "ball", "cylinder"],
)
def test_closed_shapes_face_outside_and_enclose_their_volume(shape, volume, rel):
    assert _volume(shape) == pytest.approx(volume, rel=rel)


def test_a_quad_faces_along_across_x_up():
    quad = primitives.quads((0, 0, 0), (2, 0, 0), (0, 3, 0))
    assert np.allclose(_normals(quad.vertices, quad.faces), (0, 0, 6))

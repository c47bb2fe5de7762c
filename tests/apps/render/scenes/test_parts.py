"""Shapes that scenes are built of: they face outward, are closed, and stay where they were."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.apps.render.scenes.parts import shapes


@pytest.mark.parametrize(
    ("shape", "expected", "rel"),
    [
        (shapes.boxes((0, 0, 0), (1, 2, 3)), 6.0, 1e-6),
        (shapes.boxes([(0, 0, 0), (5, 5, 5)], [(1, 1, 1), (7, 6, 6)]), 3.0, 1e-6),
        (shapes.icosphere(4), 4 / 3 * np.pi, 0.01),  # the facets lie inside the ball
        (shapes.cylinder(0.5, 1.0, 3.0, 64), np.pi / 2, 0.01),
    ],
    ids=["box", "two boxes", "ball", "cylinder"],
)
def test_closed_shapes_face_outside_and_enclose_their_volume(shape, expected, rel):
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    # the divergence theorem; negative if inside out
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(expected, rel=rel)


def test_a_quad_faces_along_across_x_up():
    quad = shapes.quads((0, 0, 0), (2, 0, 0), (0, 3, 0))
    a, b, c = np.moveaxis(quad.vertices[quad.faces], 1, 0)
    assert np.allclose(np.cross(b - a, c - a), (0, 0, 6))


def test_merge_keeps_every_triangle_where_it_was():
    parts = [shapes.icosphere(1), shapes.transform(shapes.icosphere(0), (3, 0, 0), scale=2.0)]
    merged = shapes.merge(*parts)
    apart = np.concatenate([part.vertices[part.faces] for part in parts])
    assert np.array_equal(merged.vertices[merged.faces], apart)

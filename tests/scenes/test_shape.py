"""Shapes keep their triangles when merged, transformed and painted."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.parts import shape
from rlbench.scenes.parts.primitives import icosphere


def test_merge_keeps_every_triangle_where_it_was():
    parts = [icosphere(1), shape.transform(icosphere(0), (3, 0, 0), scale=2.0)]
    merged = shape.merge(*parts)
    apart = np.concatenate([part.vertices[part.faces] for part in parts])
    assert np.array_equal(merged.vertices[merged.faces], apart)


def test_yaw_by_90_degrees_takes_x_to_y():
    assert np.allclose(shape.yaw_matrix(np.pi / 2) @ (1, 0, 0), (0, 1, 0), atol=1e-6)


def test_paint_maps_to_the_middle_of_a_texel():
    uv = shape.paint(icosphere(0), 2, 8).uv
    assert np.allclose(uv, (2.5 / 8, 0.5))

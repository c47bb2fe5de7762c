"""Glass bodies are closed, face outward and stand on their plinths."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.scenes.parts import glassware
from rlbench.scenes.ripples import bath

GLASS = {
    "vase": glassware.build_vase(),
    "crystal": glassware.build_crystal(),
    "all": glassware.build_glass_on_plinths(bath.PLINTHS),
}


def _edges(shape):
    """How often each edge of a shape occurs, in each direction, after corners are welded."""
    _, same = np.unique(shape.vertices.round(5), axis=0, return_inverse=True)
    faces = same.reshape(-1)[shape.faces]
    ahead = np.concatenate([faces, np.roll(faces, -1, 1)], 1).reshape(-1, 2, 3).swapaxes(1, 2)
    return ahead.reshape(-1, 2)


def _volume(shape):
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    return (a * np.cross(b, c)).sum() / 6  # the divergence theorem


@pytest.mark.parametrize("name", GLASS)
def test_glass_is_closed(name):
    # a path that enters through a hole would take air for glass from there on
    edges = _edges(GLASS[name])
    there = np.unique(edges, axis=0)
    back = np.unique(edges[:, ::-1], axis=0)
    assert np.array_equal(there, back)


@pytest.mark.parametrize("name", GLASS)
def test_glass_faces_outside(name):
    assert _volume(GLASS[name]) > 0


def test_a_vase_is_hollow():
    solid = np.pi * 0.24**2 * 0.75  # about its outside
    assert 0.03 * solid < _volume(glassware.build_vase()) < 0.4 * solid


def test_glass_stands_clear_of_water_and_stone():
    shape = GLASS["all"]
    low = [
        shape.vertices[np.hypot(shape.vertices[:, 0] - x, shape.vertices[:, 1] - y) < 0.9 * r, 2]
        for x, y, r, top in bath.PLINTHS
    ]
    gaps = [float(z.min() - plinth[3]) for z, plinth in zip(low, bath.PLINTHS, strict=True)]
    assert all(0 < gap < 0.06 for gap in gaps), gaps

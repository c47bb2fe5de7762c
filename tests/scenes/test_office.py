"""Panes of the office tower face outward and show cells of the window atlas."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.city import office
from rlbench.scenes.city.windows import ATLAS_CELLS, show_atlas_cells


def test_a_pane_shows_one_cell_of_the_atlas():
    panes = office.build_panes(np.random.default_rng(0), 0.0, 0.0)
    cells = np.arange(len(panes.vertices) // 4) % ATLAS_CELLS**2
    uv = show_atlas_cells(panes, cells).uv.reshape(-1, 4, 2) * ATLAS_CELLS
    assert np.array_equal(np.floor(uv[..., 0]), (cells % ATLAS_CELLS)[:, None] * np.ones(4))
    assert np.array_equal(np.floor(uv[..., 1]), (cells // ATLAS_CELLS)[:, None] * np.ones(4))


def test_panes_face_away_from_the_tower():
    panes = office.build_panes(np.random.default_rng(0), 0.0, 0.0)
    a, b, c = np.moveaxis(panes.vertices[panes.faces].astype(np.float64), 1, 0)
    assert ((np.cross(b - a, c - a)[:, :2] * (a + b + c)[:, :2]).sum(-1) > 0).all()

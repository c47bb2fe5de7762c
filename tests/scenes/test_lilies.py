"""Lily pads float on the moving water."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.scenes.ripples import bath, lilies
from rlbench.scenes.ripples import scene as ripples

PATH = (0.0, 4.0, 8.0, 20.0, 32.0, 65.0, 95.0, 1000.0)


@pytest.mark.parametrize("time", PATH)
def test_pads_lie_on_the_water_and_not_in_it(time):
    pads = lilies.build_floating(ripples._water_height, time).vertices[
        : len(lilies._build_pads().vertices)
    ]
    sheet = next(mesh for mesh in ripples._moving_meshes(time) if mesh.name == "water").vertices
    side = round(len(sheet) ** 0.5)
    width = 2 * bath.POOL_HALF_WIDTH + 0.1
    place = (pads[:, :2] + width / 2) / width * (side - 1)  # in cells
    cell = np.floor(place).astype(int)
    level = sheet[:, 2].reshape(side, side)
    corners = [level[cell[:, 1] + j, cell[:, 0] + i] for i in (0, 1) for j in (0, 1)]
    assert (pads[:, 2] > np.min(corners, 0)).all()
    assert (pads[:, 2] - np.mean(corners, 0) > 0).all()
    assert (pads[:, 2] - np.mean(corners, 0) < 0.05).all()

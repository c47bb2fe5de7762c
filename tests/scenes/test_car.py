"""Cars are symmetric, stand on the road and face outward."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.scenes.city import car


def test_cars_stand_on_their_wheels():
    assert abs(car.build_car(0).vertices[:, 2].min()) < 0.01  # metres


@pytest.mark.parametrize("coat", range(4))
def test_cars_are_as_wide_left_as_right(coat):
    y = car.build_car(coat).vertices[:, 1]
    assert y.max() == pytest.approx(-y.min(), abs=0.02)


def test_the_hull_of_a_car_faces_outside():
    hull = car._build_hull(0)[:2]  # what is not lids and floor
    for part in hull:
        a, b, c = np.moveaxis(part.vertices[part.faces].astype(np.float64), 1, 0)
        outward = (np.cross(b - a, c - a) * ((a + b + c) / 3 - (0, 0, 0.6))).sum(-1)
        assert (outward > 0).mean() > 0.95  # bonnet and arches bend inward here and there

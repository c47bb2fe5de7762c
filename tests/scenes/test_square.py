"""The road around the fountain is free of obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.scenes.city import scene as city
from rlbench.scenes.city import square

THINGS = {
    "tree": [(tree.x, tree.y) for tree in city.TREES],
    "post": square.LAMP_POSTS,
    "table": square.CAFE_TABLES,
    "parked": [place[:2] for place in square.PARKED_CARS],
    "bench": [place[:2] for place in square.BENCHES],
    "planter": square.PLANTERS,
}


@pytest.mark.parametrize("kind", THINGS)
def test_nothing_stands_in_the_road(kind):
    away = np.linalg.norm(np.array(THINGS[kind], float), axis=1)
    assert (np.abs(away - square.ROAD_RADIUS) > 1.6).all()  # half the road, metres

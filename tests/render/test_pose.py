"""Poses: projection and ray directions."""

import numpy as np

from rlbench.render.scene import Pose
from tests.render.small_scenes import room

H, W = 48, 64


def test_projection_undoes_directions():
    pose = Pose.at_time(room(), 2.0)
    film = np.random.default_rng(0).uniform(0, [W, H], (100, 2))
    rays = np.column_stack([pose.ray_directions(film, H, W), np.zeros(100)])
    np.testing.assert_allclose(pose.project(rays, H, W)[0], film, atol=1e-9)

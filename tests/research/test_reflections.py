"""What a plane mirror shows moves as its mirror image does, and only mirrors and glass move so."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from research.reflections import albedo_difference, virtual_motion
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Camera
from tests.apps.render.small_scenes import around_the_corner, diffuse, grey

SIZE, STEP = 16, 0.05  # pixels; metres that the camera moves to the right in each frame
MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": grey(0.6)}


def tracer_that_moves(material):
    def camera(time):
        return Camera((STEP * time, 0, 0), (STEP * time, 1, 0), fov=10.0)

    tracer = open_tracer(replace(around_the_corner(material), camera=camera), SIZE, SIZE)
    tracer.set_time(1.0)
    return tracer


def test_a_wall_in_a_mirror_moves_as_a_wall_behind_the_mirror():
    # the mirror's plane y = x + 4 turns the wall x = 3 into the wall y = 7
    motion, is_mirror = virtual_motion(tracer_that_moves(MIRROR))
    pixel = 2 * math.tan(math.radians(5)) / SIZE
    assert is_mirror.all()
    # Mitsuba starts a reflected ray a little off the mirror
    np.testing.assert_allclose(motion[..., 0], STEP / 7 / pixel, rtol=1e-3)
    np.testing.assert_allclose(motion[..., 1], 0, atol=1e-6)


def test_a_rough_surface_shows_nothing_behind_it():
    assert not virtual_motion(tracer_that_moves(diffuse(0.5, 0.5, 0.5)))[1].any()


@pytest.mark.parametrize(("shift", "expected"), [(1.0, 0.0), (0.0, 3.0)])
def test_albedo_agrees_along_the_motion_that_it_had(shift, expected):
    last = torch.arange(5.0).expand(1, 3, 4, 5)
    motion = torch.tensor([shift, 0.0]).view(1, 2, 1, 1).expand(1, 2, 4, 5)
    difference = albedo_difference(last, last.roll(-1, dims=3), motion)
    assert difference[..., :-1].eq(expected).all()
    assert math.isinf(difference[0, 0, 0, -1]) == (shift > 0)

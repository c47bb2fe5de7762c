"""The images that make up the frames of a clip, and the conversion of Cycles' passes."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rlbench.apps.render.cycles import frames
from rlbench.apps.render.cycles.frames import reference_images
from rlbench.apps.render.cycles.process import image_seed
from rlbench.apps.render.scene import Camera, Scene
from rlbench.clips.exr import write_exr

H, W = 4, 6
TURN = 2.0  # degrees that the camera pans to the right per frame


@pytest.mark.parametrize("total", [1, 31, 32, 33, 100])
def test_the_images_of_a_half_contain_each_sample_once(total, tmp_path):
    parts = reference_images(tmp_path, "referenceA", 3, 0, total)
    numbers = [n for part in parts for n in range(part.first, part.first + part.spp)]
    assert numbers == list(range(1, total + 1))
    assert {(part.seed, part.total) for part in parts} == {(image_seed(3, "referenceA", 0), total)}


def panning(time):
    angle = math.radians(TURN * time)
    return Camera((0, 0, 0), (math.sin(angle), math.cos(angle), 0), fov=60.0)


SCENE = Scene("pan", "pan", (), panning)


def planes(albedo=(0.5, 0.4, 0.3), normal=(0, 0, 1), depth=2.0, vector=(3.0, 5.0)):
    """One value for all pixels; the last column is sky, as Cycles writes it."""
    values = np.array([*albedo, *normal, depth, *vector], np.float32)
    channels = np.broadcast_to(values[:, None, None], (9, H, W)).copy()
    channels[:, :, -1] = np.array([9, 9, 9, 0, 0, 0, 1e10, 0, 0], np.float32)[:, None]
    return channels


CONVERTED = {  # of the first pixel; the linter refuses a surface of a depth and no normal
    "motion has y down": ({}, "motion", [3, -5]),
    "depth stays": ({}, "depth", [2.0]),
    "albedo of emitters is clipped": ({"albedo": (23.9, 0.5, -0.1)}, "albedo", [1, 0.5, 0]),
    "normals get unit length": ({"normal": (0.0, 0.3, 0.4)}, "normal", [0, 0.6, 0.8]),
    "no normal is background": ({"normal": (0, 0, 0)}, "depth", [np.inf]),
}


@pytest.mark.parametrize("case", CONVERTED)
def test_passes_of_surfaces_are_converted(case):
    values, name, expected = CONVERTED[case]
    found = frames.convert_passes(planes(**values), SCENE, 0.0)[name][0, 0]
    assert_allclose(found, expected, atol=1e-6)  # float32


def test_the_sky_is_infinite_without_albedo_and_normal():
    gbuffer = {k: v[:, -1] for k, v in frames.convert_passes(planes(), SCENE, 0.0).items()}
    assert np.isposinf(gbuffer["depth"]).all()
    assert not gbuffer["albedo"].any()
    assert not gbuffer["normal"].any()


def test_sky_moves_by_the_turn_of_the_camera():
    # after a turn to the right by TURN, what is now straight ahead was to the right before
    size = 301  # odd, so that a pixel's centre is straight ahead
    motion = frames.sky_motion(SCENE, 1.0, size, size)[size // 2, size // 2]
    focal = size / 2 / math.tan(math.radians(30))
    assert_allclose(motion, [focal * math.tan(math.radians(TURN)), 0], atol=1e-9)  # float64


def test_channels_are_found_by_name_in_a_file(tmp_path):
    channels = planes()
    file = tmp_path / "view.exr"
    write_exr(file, dict(zip(reversed(frames.GEOMETRY), channels[::-1], strict=True)))
    gbuffer = frames.read_gbuffer(file, SCENE, 0, (H, W))
    expected = frames.convert_passes(channels, SCENE, 0.0)
    assert all(np.array_equal(gbuffer[name], expected[name]) for name in expected)

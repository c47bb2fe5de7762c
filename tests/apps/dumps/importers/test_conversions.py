"""Conversions of conventions against closed forms and against the procedural world."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rlbench.apps.dumps.importers.conversions import (
    convert_depth,
    convert_motion,
    convert_normal,
    separate_samples,
)
from rlbench.apps.dumps.importers.layout import Depth, Motion, Normal
from rlbench.apps.dumps.importers.stand_ins import estimate_motion
from rlbench.clips.procedural import raycast, world
from rlbench.errors import SourceError

H, W = 36, 48
MOTION = np.stack(np.meshgrid(np.linspace(-3, 3, W), np.linspace(2, -1, H)), -1)
STORED = {  # what a renderer with a convention writes for MOTION
    Motion(files="", y="up"): MOTION * [1, -1],
    Motion(files="", unit="ndc"): MOTION / [W / 2, H / 2],
    Motion(files="", unit="shares", points="from previous"): -MOTION / [W, H],
    Motion(files="", unit="shares", offset=0.5, y="up"): MOTION / [W, -H] + 0.5,
    Motion(files="", scale=16.0): MOTION / 16,
}


@pytest.mark.parametrize("motion", STORED, ids=str)
def test_motion_in_any_convention_is_pixels_to_the_previous_frame(motion):
    # float32 of a few pixels
    np.testing.assert_allclose(convert_motion(STORED[motion], motion), MOTION, atol=1e-5)


def test_motion_that_is_not_finite_points_outside():
    stored = MOTION.copy()
    stored[3, 4, 1] = np.nan
    np.testing.assert_array_equal(convert_motion(stored, Motion(files=""))[3, 4], [-2 * W, -2 * H])


@pytest.mark.parametrize("points", ["to next", "from next"])
def test_motion_to_the_next_frame_is_turned_back(points):
    own = world.random_world(["0/0"], torch.device("cpu"))
    onward = raycast.raycast(own, 0.0, 1.0, H, W).motion[0]  # to where points are one frame later
    back = raycast.raycast(own, 1.0, 0.0, H, W)
    stored = onward.movedim(0, -1).numpy() * (1 if points == "to next" else -1)
    found = convert_motion(np.zeros_like(stored), Motion(files="", points=points), stored)
    error = np.abs(found - back.motion[0].movedim(0, -1).numpy()).max(-1)
    # interpolation between pixels of one surface; edges and disocclusions are the rest
    assert np.mean(error < 0.05) > 0.85


NEAR, FAR, DISTANCE = 0.25, 80.0, np.array([[[0.5], [3.0], [40.0]]])
WINDOWS = {
    Depth(files="", scale=0.01): DISTANCE * 100,
    Depth(files="", scale=-1.0): -DISTANCE,
    Depth(files="", kind="inverse"): 1 / DISTANCE,
    Depth(files="", kind="z-buffer", near=NEAR): 1 - NEAR / DISTANCE,
    Depth(files="", kind="z-buffer", near=NEAR, far_plane=FAR): (1 / NEAR - 1 / DISTANCE)
    / (1 / NEAR - 1 / FAR),
    Depth(files="", kind="reversed z-buffer", near=NEAR): NEAR / DISTANCE,
}


@pytest.mark.parametrize("depth", WINDOWS, ids=str)
def test_depth_of_any_kind_is_distance_along_the_view_axis(depth):
    np.testing.assert_allclose(convert_depth(WINDOWS[depth], depth), DISTANCE, rtol=1e-6)  # float32


def test_distance_to_the_camera_is_a_plane_along_the_view_axis():
    x = (np.arange(W) + 0.5 - W / 2) / (W / 2)  # tangent 1 at the edge: 90 degrees
    y = (np.arange(H)[:, None] + 0.5 - H / 2) / (W / 2)
    stored = 7 * np.sqrt(1 + x**2 + y**2)[..., None]
    found = convert_depth(stored, Depth(files="", kind="distance", fov=90.0))
    np.testing.assert_allclose(found, 7, rtol=1e-6)


@pytest.mark.parametrize(
    ("depth", "value"),
    [
        (Depth(files="", far=1e9), 1e10),
        (Depth(files="", far=-1e4, scale=-1.0), -2e4),
        (Depth(files="", background=0.0), 0.0),
        (Depth(files="", kind="z-buffer", near=0.1), 1.0),
        (Depth(files="", kind="reversed z-buffer", near=0.1, far_plane=9.0), 0.0),
        (Depth(files=""), np.nan),
    ],
)
def test_background_is_infinite(depth, value):
    assert np.isposinf(convert_depth(np.full((1, 1, 1), value), depth)).all()


@pytest.mark.parametrize(("kind", "key"), [("distance", "fov"), ("z-buffer", "near")])
def test_a_kind_of_depth_without_its_parameter_is_an_error(kind, key):
    with pytest.raises(SourceError, match=f"kind '{kind}' needs {key}"):
        convert_depth(DISTANCE, Depth(files="", kind=kind))


def test_normals_are_decoded_reordered_and_rotated():
    stored = np.array([[[0.5, 1.0, 0.5], [0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter about z
    normal = Normal(files="", encoded=True, axes=("-y", "x", "z"))
    found = convert_normal(stored, normal, turn)
    np.testing.assert_allclose(found, [[[0, -1, 0], [0, 0, 0], [0, 0, 0]]], atol=1e-7)


def test_samples_are_separated_from_their_means():
    samples = np.random.default_rng(0).exponential(size=(8, 5, 6, 3))
    means = np.cumsum(samples, 0) / np.arange(1, 9)[:, None, None, None]
    np.testing.assert_allclose(separate_samples(list(means)), samples, atol=1e-6)  # float32


def test_optical_flow_points_to_the_previous_position():
    rows, columns = np.mgrid[:48, :64].astype(float)

    def pattern(x, y):
        return np.sin(x / 4) + np.cos(y / 5) + np.sin((x + y) / 7)

    current = pattern(columns, rows)[..., None].repeat(3, -1)
    previous = pattern(columns - 1.5, rows + 0.75)[..., None].repeat(3, -1)
    found = estimate_motion(current, previous)[8:-8, 8:-8]
    # the method smooths; a tenth of a pixel on a smooth pattern
    np.testing.assert_allclose(np.median(found, (0, 1)), [1.5, -0.75], atol=0.1)

"""Scenes as data: takes, light changes, projections, and fingerprints."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.scene import Pose
from tests.apps.render.small_scenes import OTHER_CAMERA, diffuse, room, room_with_takes, square

H, W = 48, 64


def test_a_take_changes_only_what_it_defines():
    scene = room_with_takes()
    still, cut = scene.select_take("still"), scene.select_take("cut")
    assert [mesh.name for mesh in still.meshes] == [mesh.name for mesh in scene.meshes]
    assert (still.name, still.sky, still.exposure, still.max_depth) == ("room", scene.sky, 2.0, 8)
    assert (still.static, still.camera(7.0), still.takes) == (True, OTHER_CAMERA, ())
    assert still.vertex_animation(7.0) == {}
    moved, expected = (each.vertex_animation(3.0)["cube"] for each in (cut, scene))
    assert np.array_equal(moved, expected)


def test_light_changes_are_the_frames_whose_lights_differ_from_the_frame_before():
    take = room_with_takes().select_take("cut")  # the lamp goes out at frame 3
    assert take.light_changes(3) == ()
    assert take.light_changes(8) == (3,)
    assert room_with_takes().light_changes(8) == ()


def test_projection_undoes_directions():
    pose = Pose.at_time(room(), 2.0)
    film = np.random.default_rng(0).uniform(0, [W, H], (100, 2))
    rays = np.column_stack([pose.ray_directions(film, H, W), np.zeros(100)])
    np.testing.assert_allclose(pose.project(rays, H, W)[0], film, atol=1e-9)


def test_a_fingerprint_ignores_takes_and_the_last_bit_of_a_number():
    jitter = replace(room().meshes[1], vertices=room().meshes[1].vertices * np.float32(1 + 1e-7))
    other = replace(room(), meshes=(room().meshes[0], jitter, *room().meshes[2:]))
    assert fingerprint(room(), 8) == fingerprint(other, 8) == fingerprint(room_with_takes(), 8)


@pytest.mark.parametrize(
    "change",
    [
        {"meshes": (*room().meshes, square("new", 1.0, 2.0, diffuse(0, 0, 0)))},
        {"lights": lambda time: {"lamp": 0.5 if time == 3 else 1.0}},
        {"cuts": (2,)},
        {
            "camera": lambda time: OTHER_CAMERA if time in (1.0, 2.0) else room().camera(time),
            "cuts": (2,),
        },
    ],
    ids=["mesh", "lights", "cuts", "camera"],
)
def test_a_fingerprint_notices_a_change(change):
    assert fingerprint(replace(room(), **change), 8) != fingerprint(room(), 8)

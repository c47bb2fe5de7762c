"""Scenes as data: takes and light changes; poses, rays and projections."""

import numpy as np

from rlbench.apps.render.scene import Pose
from tests.apps.render.small_scenes import OTHER_CAMERA, room, room_with_takes

H, W = 48, 64


def test_a_take_changes_only_what_it_defines():
    scene, take = room_with_takes(), room_with_takes().select_take("still")
    assert [mesh.name for mesh in take.meshes] == [mesh.name for mesh in scene.meshes]
    assert (take.name, take.sky, take.exposure, take.max_depth) == ("room", scene.sky, 2.0, 8)
    assert (take.static, take.camera(7.0), take.vertex_animation(7.0), take.takes) == (
        True,
        OTHER_CAMERA,
        {},
        (),
    )


def test_a_take_without_vertex_animation_moves_like_the_scene():
    scene = room_with_takes()
    assert np.array_equal(
        scene.select_take("cut").vertex_animation(3.0)["cube"], scene.vertex_animation(3.0)["cube"]
    )


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

"""The four test scenes are valid data: deterministic, animated as declared, without a renderer."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import import_module
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.scene import Scene

NAMES = ("city", "temple", "hall", "ripples")
TIMES = (-1.0, 0.0, 0.5, 7.0, 40.0)


@cache
def _scene(name: str) -> Scene:
    return import_module(f"rlbench.apps.render.scenes.{name}.scene").scene()


@pytest.fixture(scope="module", params=NAMES)
def scene(request) -> Scene:
    return _scene(request.param)


def _normals(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces].astype(np.float64), 1, 0)
    return np.cross(b - a, c - a)  # twice the area long


FINGERPRINTS = {  # of the clips that were published, by take; another scene is another preset
    "city": {"": "247847afd8d51922", "static": "f0d0b6ba7e4b56d1", "cut": "bfa9b54a7a989177"},
    "temple": {"": "f376b2a88ab87c36", "static": "a17a7cbb5727d392", "cut": "2c470a42afbd1337"},
    "hall": {"": "d966c69f324d4fd6", "static": "cb20e1dda6e3dc3f", "cut": "82e583a28a6a33e9"},
    "ripples": {"": "c9d86315c412eca8", "static": "a2f7a4b209efd374", "cut": "d2ea2e9c55ac6b3c"},
}


def test_scenes_are_those_of_the_published_results(scene):
    takes = {"": scene, **{name: scene.select_take(name) for name in ("static", "cut")}}
    found = {name: fingerprint(take, 20) for name, take in takes.items()}
    assert found == FINGERPRINTS[scene.name]


def test_faces_index_vertices(scene):
    assert all(mesh.faces.max() < len(mesh.vertices) for mesh in scene.meshes)


def test_every_vertex_is_used(scene):
    assert all(len(np.unique(mesh.faces)) == len(mesh.vertices) for mesh in scene.meshes)


def test_arrays_have_the_shapes_and_types_of_the_contract(scene):
    for mesh in scene.meshes:
        assert mesh.vertices.shape[1:] == (3,)
        assert mesh.faces.shape[1:] == (3,)
        assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float32, np.uint32)
        assert mesh.uv is not None
        assert mesh.uv.shape == (len(mesh.vertices), 2)
        assert mesh.uv.dtype == np.float32


def test_vertices_are_finite_and_no_triangle_is_empty(scene):
    poses = map(scene.vertex_animation, TIMES)
    for moved, mesh in product(poses, scene.meshes):
        vertices = moved.get(mesh.name, mesh.vertices)
        assert np.isfinite(vertices).all()
        area = np.linalg.norm(_normals(vertices, mesh.faces), axis=1) / 2
        assert area.min() > 1e-9, mesh.name  # square metres; float32 cancels below


def test_names_are_unique_and_meshes_are_few(scene):
    names = [mesh.name for mesh in scene.meshes]
    assert len(set(names)) == len(names)
    assert len(names) <= 15  # every mesh costs time in every launch


def test_the_animation_returns_vertices_of_existing_meshes(scene):
    rest = {mesh.name: mesh.vertices for mesh in scene.meshes}
    for moved in map(scene.vertex_animation, TIMES):
        assert moved
        assert {name: v.shape for name, v in moved.items()} == {n: rest[n].shape for n in moved}
        assert all(vertices.dtype == np.float32 for vertices in moved.values())


def test_meshes_stand_as_at_time_zero(scene):
    rest = {mesh.name: mesh.vertices for mesh in scene.meshes}
    assert all(
        np.array_equal(vertices, rest[n]) for n, vertices in scene.vertex_animation(0.0).items()
    )


def test_every_moving_mesh_moves_each_frame(scene):
    for time in range(20):
        before, after = scene.vertex_animation(time - 1), scene.vertex_animation(time)
        assert all(np.abs(after[name] - before[name]).max() > 1e-3 for name in after)


def test_the_same_time_gives_the_same_pose(scene):
    first = scene.vertex_animation(7.0)
    scene.vertex_animation(3.0)  # in between, another time
    second = scene.vertex_animation(7.0)
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert scene.camera(7.0) == scene.camera(7.0)


def test_two_calls_build_the_same_scene(scene):
    again = _scene.__wrapped__(scene.name)
    for one, other in zip(scene.meshes, again.meshes, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)
        assert np.array_equal(one.uv, other.uv)


def _pixel(camera, point, width=192):
    """Where a pinhole camera of `width` pixels sees a point, from the image's middle."""
    forward = np.subtract(camera.target, camera.origin)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    towards = np.subtract(point, camera.origin)
    focal = width / 2 / np.tan(np.radians(camera.fov) / 2)
    across = np.array([towards @ right, towards @ np.cross(right, forward)])
    return focal * across / (towards @ forward)


def test_the_camera_moves_some_pixels_a_frame(scene):
    for before, now in pairwise(map(scene.camera, range(-1, 20))):
        middle = np.add(now.origin, 8 * _ahead(now))
        shift = np.linalg.norm(_pixel(before, middle) - _pixel(now, middle))
        assert 0.3 < shift < 8  # of 192: enough to need motion vectors, not a cut


def _ahead(camera):
    forward = np.subtract(camera.target, camera.origin)
    return forward / np.linalg.norm(forward)


def _takes(scene):
    """All clips of a scene as scenes of their own."""
    return [scene, *(scene.select_take(take.name) for take in scene.takes)]


def test_every_scene_has_a_take_with_a_camera_that_stands_while_things_move(scene):
    take = scene.select_take("static")
    assert take.camera(3.0) == take.camera(17.0)
    assert not take.static
    before, after = take.vertex_animation(3.0), take.vertex_animation(4.0)
    assert all(np.abs(after[name] - before[name]).max() > 1e-3 for name in after)


def test_every_scene_has_a_take_with_a_cut_and_a_light_that_changes_at_another_frame(scene):
    take = scene.select_take("cut")
    places = np.array([take.camera(float(t)).origin for t in range(20)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert take.cuts == (10,)
    assert steps.argmax() == 9  # from frame 9 to frame 10
    assert steps[9] > 10 * np.delete(steps, 9).max()
    changes = [t for t in range(1, 20) if take.lights(float(t)) != take.lights(t - 1.0)]
    assert changes
    assert not set(changes) & {9, 10, 11}


def test_lights_that_change_exist(scene):
    lamps = {mesh.name for mesh in scene.meshes if mesh.emission}
    skies = {f"sky{number}" for number in range(len(scene.sky))}
    assert all(set(take.lights(19.0)) <= lamps | skies for take in scene.takes)


def test_both_shots_have_the_same_field_of_view(scene):
    take = scene.select_take("cut")  # or `rlbench lint`, which fits one, could not tell it
    assert take.camera(9.0).fov == take.camera(10.0).fov


def test_exactly_the_takes_without_motion_are_static(scene):
    for take in _takes(scene):
        moved, camera = take.vertex_animation(7.0), take.camera(7.0)
        assert take.static == (not moved and camera == take.camera(0.0))


def test_every_scene_is_registered(scene):
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["rlbench.scenes"]
    assert points[scene.name] == f"rlbench.apps.render.scenes.{scene.name}.scene:scene"

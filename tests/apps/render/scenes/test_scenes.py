"""The four test scenes: those of the published results, valid, and moving in each frame."""

from __future__ import annotations

import tomllib
from importlib import import_module
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.scene import Scene

TIMES = (-1.0, 0.0, 0.5, 7.0, 40.0)
FINGERPRINTS = {  # of the clips that were published, by take; another scene is another preset
    "city": {"": "247847afd8d51922", "static": "f0d0b6ba7e4b56d1", "cut": "bfa9b54a7a989177"},
    "temple": {"": "f376b2a88ab87c36", "static": "a17a7cbb5727d392", "cut": "2c470a42afbd1337"},
    "hall": {"": "d966c69f324d4fd6", "static": "cb20e1dda6e3dc3f", "cut": "82e583a28a6a33e9"},
    "ripples": {"": "c9d86315c412eca8", "static": "a2f7a4b209efd374", "cut": "d2ea2e9c55ac6b3c"},
}


@pytest.fixture(scope="module", params=FINGERPRINTS)
def scene(request) -> Scene:
    return import_module(f"rlbench.apps.render.scenes.{request.param}.scene").scene()


def test_scenes_are_those_of_the_published_results(scene):
    takes = {"": scene, **{name: scene.select_take(name) for name in ("static", "cut")}}
    found = {name: fingerprint(take, 20) for name, take in takes.items()}
    assert found == FINGERPRINTS[scene.name]


def test_arrays_are_as_the_contract_says_and_faces_use_every_vertex(scene):
    names = [mesh.name for mesh in scene.meshes]
    assert len(set(names)) == len(names) <= 15  # every mesh costs time in every launch
    for mesh in scene.meshes:
        assert mesh.vertices.shape[1:] == mesh.faces.shape[1:] == (3,)
        assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
        assert mesh.uv is not None
        assert mesh.uv.shape == (len(mesh.vertices), 2)
        assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float32, np.uint32)
        assert mesh.uv.dtype == np.float32


def test_vertices_are_finite_and_no_triangle_is_empty(scene):
    for moved, mesh in product(map(scene.vertex_animation, TIMES), scene.meshes):
        vertices = moved.get(mesh.name, mesh.vertices)
        assert np.isfinite(vertices).all()
        a, b, c = np.moveaxis(vertices[mesh.faces].astype(np.float64), 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        assert area.min() > 1e-9, mesh.name  # square metres; float32 cancels below


def test_moving_meshes_move_each_frame_from_where_they_stand_at_time_zero(scene):
    rest = {mesh.name: mesh.vertices for mesh in scene.meshes}
    assert all(np.array_equal(v, rest[n]) for n, v in scene.vertex_animation(0.0).items())
    poses = [scene.vertex_animation(float(time)) for time in range(-1, 20)]
    for before, after in zip(poses, poses[1:], strict=False):
        assert {n: (v.shape, v.dtype) for n, v in after.items()} == {
            name: (rest[name].shape, np.float32) for name in before
        }
        assert all(np.abs(after[name] - before[name]).max() > 1e-3 for name in after)
    again = scene.vertex_animation(7.0)  # after other times
    assert all(np.array_equal(again[name], poses[8][name]) for name in again)


def test_lights_that_change_exist(scene):
    lamps = {mesh.name for mesh in scene.meshes if mesh.emission}
    skies = {f"sky{number}" for number in range(len(scene.sky))}
    assert all(set(take.lights(19.0)) <= lamps | skies for take in scene.takes)


def test_every_scene_is_registered(scene):
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["rlbench.scenes"]
    assert points[scene.name] == f"rlbench.apps.render.scenes.{scene.name}.scene:scene"

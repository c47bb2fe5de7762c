"""The scene is closed, and moves as it says."""

from __future__ import annotations

from importlib import import_module

import numpy as np

scene = import_module("$name.scene").scene()
meshes = {mesh.name: mesh for mesh in scene.meshes}


def test_the_faces_of_the_box_look_outwards() -> None:
    box = meshes["box"]
    a, b, c = (box.vertices[box.faces[:, corner]] for corner in range(3))
    outwards = (a + b + c) / 3 - box.vertices.mean(0)
    assert (np.sum(np.cross(b - a, c - a) * outwards, axis=1) > 0).all()


def test_the_box_slides_along_x() -> None:
    step = scene.vertex_animation(2.0)["box"] - scene.vertex_animation(1.0)["box"]
    np.testing.assert_allclose(step, [[0.05, 0, 0]] * 8, atol=1e-6)


def test_the_camera_looks_from_above_the_floor() -> None:
    assert all(scene.camera(float(frame)).origin[2] > 0 for frame in range(20))

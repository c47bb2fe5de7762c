"""Random walks of a camera, and their places in rooms."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from rlbench.render.cycles import infinigen_rooms as room_cameras
from rlbench.render.cycles.process import convert_axes
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.scene import SceneError
from rlbench.render.user import camera_path
from tests.render.cycles import shared_scene

SEEDS = (0, 1, 2, 7)
FRAMES = 6
CLEARANCE = 0.35  # metres, of the worker


@pytest.mark.parametrize("seed", SEEDS)
def test_a_walk_is_a_rigid_movement(seed):
    for matrix in room_cameras.walk(seed, FRAMES):
        camera_path.check_rigid(convert_axes(matrix), "walk")


@pytest.mark.parametrize("seed", SEEDS)
def test_a_walk_starts_at_its_place_and_looks_ahead(seed):
    first = room_cameras.walk(seed, FRAMES)[0]
    assert not first[:3, 3].any()
    forward, right = -first[:3, 2], first[:3, 0]
    assert forward[1] > 0.9
    assert right == pytest.approx([1, 0, 0])


@pytest.mark.parametrize("seed", SEEDS)
def test_every_frame_of_a_walk_makes_the_same_movement(seed):
    matrices = room_cameras.walk(seed, FRAMES)
    movements = [np.linalg.inv(a) @ b for a, b in zip(matrices[:-1], matrices[1:], strict=True)]
    assert np.allclose(movements, movements[0], atol=1e-12)


def test_seeds_walk_differently():
    assert not np.allclose(*(room_cameras.walk(seed, FRAMES) for seed in (0, 1)))


@pytest.fixture(scope="module")
def walks(blender, tmp_path_factory):
    """Camera paths in the shared scene."""
    folder = tmp_path_factory.mktemp("scene")
    shared_scene.for_blender(folder)
    return room_cameras.place_cameras(folder / "both.gltf", folder, 3, FRAMES)


def test_placed_cameras_see_a_room_and_touch_nothing(walks, llvm):
    tracer = open_tracer(shared_scene.for_mitsuba(), 32, 32)
    for file in walks:
        matrices, fov = camera_path.read_matrices(file)
        assert len(matrices) == FRAMES
        for matrix in matrices:
            camera = camera_path.camera_from_matrix(matrix, fov)
            tracer.scene = replace(tracer.scene, camera=lambda time, camera=camera: camera)
            tracer.set_time(0.0)
            depth = render_gbuffer(tracer, ("depth",))["depth"]
            assert np.isfinite(depth).mean() > 0.9  # the worker allows 5 % of fewer rays
            assert depth.min() > CLEARANCE * 0.75  # depth is along the axis, and rays are denser


def test_paths_that_exist_are_kept(walks, monkeypatch):
    monkeypatch.setenv("RLBENCH_CYCLES_PYTHON", "/nowhere")
    folder = walks[0].parent
    assert room_cameras.place_cameras(folder / "both.gltf", folder, 3, FRAMES) == walks


def test_more_paths_leave_the_first_as_they_were(walks, tmp_path):
    more = room_cameras.place_cameras(walks[0].parent / "both.gltf", tmp_path, 4, FRAMES)
    assert [file.read_text() for file in more[:3]] == [file.read_text() for file in walks]


def test_rays_meet_what_is_rendered_whatever_blender_shows(blender, walks, tmp_path):
    folder = walks[0].parent
    code = f"""
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath={str(folder / "both.gltf")!r})
kept = bpy.data.collections.new("kept")
bpy.context.scene.collection.children.link(kept)
for item in list(bpy.context.scene.objects):
    for owner in list(item.users_collection):
        owner.objects.unlink(item)
    kept.objects.link(item)
kept.hide_viewport = True
bpy.ops.mesh.primitive_cube_add(size=1.5, location=(0, -2, 1.5))
bpy.context.object.hide_render = True
bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / "hidden.blend")!r})
"""
    subprocess.run([blender, "-I", "-c", code], check=True, capture_output=True)
    hidden = room_cameras.place_cameras(tmp_path / "hidden.blend", tmp_path, 3, FRAMES)
    for file, expected in zip(hidden, walks, strict=True):
        found, wanted = (camera_path.read_matrices(path)[0] for path in (file, expected))
        assert np.allclose(found, wanted, atol=1e-5)


def test_a_scene_without_a_ceiling_has_no_room(blender, tmp_path, monkeypatch):
    shapes = shared_scene.parts()
    open_air = {name: shape for name, shape in shapes.items() if name not in ("ceiling", "lamp")}
    monkeypatch.setattr(shared_scene, "parts", lambda: open_air)
    shared_scene.for_blender(tmp_path)
    with pytest.raises(SceneError, match="0 of 1 camera paths .* times no floor below a ceiling"):
        room_cameras.place_cameras(tmp_path / "both.gltf", tmp_path, 1, FRAMES)

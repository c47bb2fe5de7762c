"""Rooms by Infinigen: environment, generation, and random walks of a camera in them."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.cycles import infinigen_rooms
from rlbench.apps.render.cycles.infinigen_rooms import InfinigenError, Room
from rlbench.apps.render.cycles.process import convert_axes
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.user import camera_path
from rlbench.errors import OptionError
from tests.apps.render.cycles import shared_scene

WRITES = """
while [ "$1" != --output_folder ]; do shift; done
mkdir -p "$2" && echo room > "$2/scene.blend"
"""
SEEDS = (0, 1, 2, 7)
FRAMES = 6
CLEARANCE = 0.35  # metres, of the worker


@pytest.fixture
def room(tmp_path):
    return Room("Kitchen", 2, tmp_path / "rooms")


@pytest.fixture
def python(tmp_path):
    """An environment whose Python is a script."""

    def install(body):
        environment = tmp_path / "infinigen"
        (environment / "lib/python3.11/site-packages").mkdir(parents=True, exist_ok=True)
        (environment / "installed.txt").write_text(infinigen_rooms.INFINIGEN)
        script = environment / "bin" / "python"
        script.parent.mkdir(exist_ok=True)
        script.write_text(f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
        return script

    return install


@pytest.mark.parametrize("text", ["Kitchen", "Kitchen:", "Kitchen:-1", "Kitchen:x", "Attic:1", ""])
def test_what_is_no_room_is_an_error_that_shows_one(text, tmp_path):
    with pytest.raises(OptionError, match="Write Kind:seed, such as Kitchen:2"):
        infinigen_rooms.parse_rooms(text, tmp_path)


def test_a_generated_scene_has_the_seed_kind_and_name_of_its_room(room, python, tmp_path):
    script = python(f'echo "$*" > {tmp_path}/words{WRITES}')
    file = infinigen_rooms.generate_room(script, room)
    words = (tmp_path / "words").read_text().strip()
    assert "--seed 2 " in words
    assert words.endswith('restrict_solving.restrict_parent_rooms=["Kitchen"]')
    assert (file.name, file.read_text()) == ("kitchen-2.blend", "room\n")
    assert not (room.folder / "unfinished").exists()  # and a finished one is not made again
    assert infinigen_rooms.generate_room(tmp_path / "nowhere", room) == file


def test_a_killed_generation_begins_again(room, python):
    with pytest.raises(InfinigenError, match="exit code -9"):
        infinigen_rooms.generate_room(python(f"{WRITES}touch $2/half; kill -9 $$"), room)
    assert not room.blend.exists()
    empty = f"[ ! -e {room.folder}/unfinished/half ] || exit 1\n{WRITES}"
    assert infinigen_rooms.generate_room(python(empty), room).is_file()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("echo no Beams >&2; exit 3", r"(?s)exit code 3.*generate.log.*no Beams"),
        ("exit 0", "wrote no .*scene.blend"),
    ],
)
def test_the_error_of_a_failed_generation_says_what_happened(room, python, body, message):
    with pytest.raises(InfinigenError, match=message):
        infinigen_rooms.generate_room(python(body), room)


def test_an_installed_environment_is_kept(tmp_path):
    folder = tmp_path / "infinigen"
    folder.mkdir()
    (folder / "installed.txt").write_text("infinigen==1")
    python = infinigen_rooms.ensure_environment(folder, "infinigen==1")
    assert [file.name for file in folder.iterdir()] == ["installed.txt"]
    assert python == folder / "bin" / "python"


@pytest.mark.slow
def test_the_error_of_pip_has_the_end_of_its_log(tmp_path):
    folder = tmp_path / "environment"
    with pytest.raises(
        InfinigenError, match=r"(?s)pip install \./nothing.*environment.log:.*nothing"
    ):
        infinigen_rooms.ensure_environment(folder, "./nothing")
    assert not (folder / "installed.txt").exists()


def test_one_failed_room_does_not_stop_the_others(tmp_path, python, capsys):
    python(f'case "$*" in *Kitchen*) exit 1;; esac\n{WRITES}')
    with pytest.raises(SystemExit, match="1 of 2 rooms failed: kitchen-1"):
        infinigen_rooms.main([str(tmp_path), "--rooms", "Kitchen:1,Bedroom:2", "--rooms-only"])
    assert (tmp_path / "bedroom-2" / "bedroom-2.blend").is_file()
    assert "error: kitchen-1: " in capsys.readouterr().out


@pytest.mark.parametrize("seed", SEEDS)
def test_a_walk_starts_ahead_and_makes_the_same_rigid_movement_in_each_frame(seed):
    matrices = infinigen_rooms.walk(seed, FRAMES)
    for matrix in matrices:
        camera_path.check_rigid(convert_axes(matrix), "walk")
    assert not matrices[0][:3, 3].any()
    assert -matrices[0][1, 2] > 0.9  # forward
    assert matrices[0][:3, 0] == pytest.approx([1, 0, 0])  # right
    movements = [np.linalg.inv(a) @ b for a, b in zip(matrices[:-1], matrices[1:], strict=True)]
    assert np.allclose(movements, movements[0], atol=1e-12)
    assert not np.allclose(matrices, infinigen_rooms.walk(seed + 1, FRAMES))


@pytest.fixture(scope="module")
def walks(blender, tmp_path_factory):
    """Camera paths in the shared scene."""
    folder = tmp_path_factory.mktemp("scene")
    shared_scene.for_blender(folder)
    return infinigen_rooms.place_cameras(folder / "both.gltf", folder, 3, FRAMES)


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
    assert infinigen_rooms.place_cameras(folder / "both.gltf", folder, 3, FRAMES) == walks


def test_more_paths_leave_the_first_as_they_were(walks, tmp_path):
    more = infinigen_rooms.place_cameras(walks[0].parent / "both.gltf", tmp_path, 4, FRAMES)
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
    hidden = infinigen_rooms.place_cameras(tmp_path / "hidden.blend", tmp_path, 3, FRAMES)
    for file, expected in zip(hidden, walks, strict=True):
        found, wanted = (camera_path.read_matrices(path)[0] for path in (file, expected))
        assert np.allclose(found, wanted, atol=1e-5)


def test_a_scene_without_a_ceiling_has_no_room(blender, tmp_path, monkeypatch):
    shapes = shared_scene.parts()
    open_air = {name: shape for name, shape in shapes.items() if name not in ("ceiling", "lamp")}
    monkeypatch.setattr(shared_scene, "parts", lambda: open_air)
    shared_scene.for_blender(tmp_path)
    with pytest.raises(SceneError, match="0 of 1 camera paths .* times no floor below a ceiling"):
        infinigen_rooms.place_cameras(tmp_path / "both.gltf", tmp_path, 1, FRAMES)

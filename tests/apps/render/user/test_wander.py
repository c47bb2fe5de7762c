"""Random camera paths: in free space by exact geometry, smooth, and the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Camera, Scene, SceneError, XmlFile
from rlbench.apps.render.user import auto_exposure, camera_path
from rlbench.apps.render.user.wander import NO_SURFACE, TURN, wander
from rlbench.clips.header import read_header
from tests.apps.render.user.xml_room import document
from tests.cli.runner import rlbench

WIDTH, HEIGHT, DEPTH = 8.0, 2.6, 4.0  # metres; x from -4 to 4, y from 0 up, z from -2 to 2
DOOR = 0.5  # the wall at x = 0 has a door for |z| below
FRAMES, FOV = 6, 70.0
START = camera_path.matrix_from_camera(Camera((-2.5, 1.4, 0.6), (0, 1.2, -0.3), (0, 1, 0), FOV))


def _box(low, high):
    middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
    x, y, z = middle
    a, b, c = half
    return (
        f'<shape type="cube"><transform name="toWorld"><scale x="{a}" y="{b}" z="{c}"/>'
        f'<translate x="{x}" y="{y}" z="{z}"/></transform></shape>'
    )


THIN = 0.05
WALLS = [
    ((-4, -THIN, -2), (4, 0, 2)),
    ((-4, HEIGHT, -2), (4, HEIGHT + THIN, 2)),
    ((-4, 0, -2 - THIN), (4, HEIGHT, -2)),
    ((-4, 0, 2), (4, HEIGHT, 2 + THIN)),
    ((-4 - THIN, 0, -2), (-4, HEIGHT, 2)),
    ((4, 0, -2), (4 + THIN, HEIGHT, 2)),
    ((-THIN, 0, -2), (THIN, HEIGHT, -DOOR)),
    ((-THIN, 0, DOOR), (THIN, HEIGHT, 2)),
]
FURNITURE = [((x, 0, z), (x + 0.7, 0.8, z + 0.7)) for x in (-3.8, 1.2, 3) for z in (-1.9, 1.1)]
LAMPS = "".join(
    f'<shape type="sphere"><point name="center" x="{x}" y="2.3" z="0"/><float name="radius" '
    'value="0.1"/><emitter type="area"><rgb name="radiance" value="30"/></emitter></shape>'
    for x in (-2, 2)
)


def write_flat(folder, more=""):
    """The room with a door as a file that has a sensor."""
    sensor = (
        '<sensor type="perspective"><float name="fov" value="70"/><transform name="toWorld">'
        '<lookat origin="-2.5, 1.4, 0.6" target="0, 1.2, -0.3" up="0, 1, 0"/></transform></sensor>'
    )
    boxes = "".join(_box(*box) for box in (*WALLS, *FURNITURE))
    return document(folder, sensor + more + boxes + LAMPS)


def _tracer(folder, boxes=(*WALLS, *FURNITURE), lights=LAMPS):
    file = document(folder, "".join(_box(*box) for box in boxes) + lights)
    start = camera_path.camera_from_matrix(START, FOV)
    scene = Scene("room", "room", (), lambda time: start, max_depth=4, xml_file=XmlFile(file))
    return open_tracer(scene, 24, 32)


@pytest.fixture(scope="module")
def room_with_a_door(usable_llvm, tmp_path_factory):
    select_variant("llvm_ad_rgb")
    return _tracer(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def paths(room_with_a_door):
    return [wander(room_with_a_door, START, FOV, FRAMES, seed) for seed in range(12)]


def test_every_position_is_in_the_room_and_outside_of_all_boxes(paths):
    points = np.array([matrix[:3, 3] for path in paths for matrix in path])
    for low, high in (*WALLS, *FURNITURE):
        inside = ((points > low) & (points < high)).all(1)
        assert not inside.any()
    assert (abs(points - [0, HEIGHT / 2, 0]) < [WIDTH / 2, HEIGHT / 2, DEPTH / 2]).all()


def test_no_path_crosses_the_wall_beside_the_door(paths):
    for path in paths:
        points = np.array([matrix[:3, 3] for matrix in path])
        for before, after in zip(points, points[1:], strict=False):
            if before[0] * after[0] < 0:
                fraction = before[0] / (before[0] - after[0])
                assert abs(before[2] + fraction * (after[2] - before[2])) < DOOR


def test_some_paths_lie_beyond_the_door(paths):
    sides = {float(np.sign(path[0][0, 3])) for path in paths}
    assert sides == {-1.0, 1.0}


def test_the_same_seed_gives_the_same_path_and_another_seed_another(llvm, room_with_a_door, paths):
    again = wander(room_with_a_door, START, FOV, FRAMES, 3)
    np.testing.assert_array_equal(again, paths[3])
    assert len({path[0].tobytes() for path in paths}) == len(paths)


def test_frames_are_rigid_upright_and_follow_each_other_smoothly(paths):
    for path in paths:
        for matrix in path:
            camera_path.check_rigid(matrix, "a frame")
            assert abs(matrix[1, 0]) < 1e-9  # no roll: the axis to the left is level
        steps = np.diff([matrix[:3, 3] for matrix in path], axis=0)
        turns = [np.sum(a[:3, 2] * b[:3, 2]) for a, b in zip(path, path[1:], strict=False)]
        assert (np.linalg.norm(steps, axis=1) < 0.2).all()
        np.testing.assert_allclose(steps, steps[:1].repeat(len(steps), 0), atol=1e-9)
        assert np.arccos(np.clip(turns, -1, 1)).max() <= TURN + 1e-6


def test_most_pixels_show_a_surface_where_a_wall_is_open(llvm, tmp_path):
    tracer = _tracer(tmp_path, [*(wall for wall in WALLS if wall[0][2] != 2), *FURNITURE])
    for seed in range(4):
        for matrix in wander(tracer, START, FOV, FRAMES, seed)[:: FRAMES - 1]:
            camera = camera_path.camera_from_matrix(matrix, FOV)
            tracer.scene = replace(tracer.scene, camera=lambda time, camera=camera: camera)
            tracer.set_time(0.0)
            misses = np.isinf(auto_exposure.hit_distances(tracer)[0]).mean()
            assert misses <= NO_SURFACE  # where the file's own camera sees 7 % of the sky


def test_a_start_that_sees_no_surface_is_an_error_with_a_way_out(llvm, tmp_path):
    tracer = _tracer(tmp_path, [((-9, -9, 8), (9, 9, 9))], "")  # behind the camera
    with pytest.raises(SceneError, match="sees no surface.*JSON file of matrices"):
        wander(tracer, START, FOV, FRAMES, 0)


@pytest.mark.parametrize(
    ("bound", "value", "message"),
    [("DARKEST", 9.0, "too little light arrives"), ("NEAR", 9.0, "a surface is too near")],
)
def test_a_seed_without_a_path_says_which_check_failed(
    llvm, room_with_a_door, monkeypatch, bound, value, message
):
    monkeypatch.setattr("rlbench.apps.render.user.wander.DETAIL", (0, 0))  # no view fails for it
    monkeypatch.setattr("rlbench.apps.render.user.wander.TRIES", 4)
    monkeypatch.setattr(f"rlbench.apps.render.user.wander.{bound}", value)
    with pytest.raises(SceneError, match=f"no path of seed 0 .* because {message}"):
        wander(room_with_a_door, START, FOV, FRAMES, 0)


def test_the_command_renders_a_clip_for_each_seed(llvm, tmp_path, monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
    words = ("--seeds", "1,4", "--preset", "tiny", "--frames", 2, "--size", "24x16")
    words = (write_flat(tmp_path / "flat"), *words, "--out", tmp_path / "out", "--camera")
    rlbench("render", *words, "wander")
    names = {read_header(folder).name for folder in (tmp_path / "out").iterdir()}
    assert names == {"flat-wander-001", "flat-wander-004"}
    assert "--camera wander" in rlbench("render", *words, "orbit", code=2)

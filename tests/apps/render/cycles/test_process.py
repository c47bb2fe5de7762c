"""The job of the Cycles worker, and errors of its process: missing bpy, rejected job, crash."""

import json
import os
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rlbench.apps.render.commands.render import select_tracer
from rlbench.apps.render.cycles import clip, process, scene_file
from rlbench.apps.render.cycles.process import (
    SEEDS_PER_STREAM,
    STREAMS,
    CyclesError,
    CyclesParameters,
    ImageTask,
    convert_axes,
    image_seed,
    render_job,
)
from rlbench.apps.render.scene import Camera, Scene, SceneError
from rlbench.apps.render.user import camera_path
from rlbench.apps.render.user.clip import UserSceneOptions
from rlbench.clips.presets import get_preset
from tests.apps.render.cycles import shared_scene

LEVEL = Scene("s", "s", (), lambda time: Camera((time, -4.0, 1.0), (time, 0.0, 1.0), fov=40.0))


def test_no_two_images_share_a_seed_and_seeds_stay_below_what_cycles_takes():
    seeds = [image_seed(*which) for which in product(range(5), STREAMS, range(SEEDS_PER_STREAM))]
    assert len(set(seeds)) == len(seeds)
    assert image_seed(10_000, "pilot", SEEDS_PER_STREAM - 1) < 2**31  # of ten thousand frames


def test_a_camera_that_looks_north_does_so_in_blenders_axes():
    matrix = convert_axes(camera_path.matrix_from_camera(LEVEL.camera(0.0)))
    right, up, back, position = matrix[:3].T
    assert_allclose([right, up, back], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)  # float64
    assert_allclose(position, [0, -4, 1])


def test_a_job_is_json_with_absolute_paths_and_the_camera_of_a_frame_before_and_after():
    parameters, pictures = CyclesParameters(max_bounces=4), [ImageTask(Path("a.exr"), 0, 1)]
    job = render_job(Path("a.blend"), LEVEL, 1, 3, (8, 9), parameters, pictures)
    job = json.loads(json.dumps(job))
    assert_allclose(np.array(job["camera"]["matrices"])[:, 0, 3], [-1, 0, 1, 2, 3])
    assert Path(job["scene"]).is_absolute()
    assert Path(job["renders"][0]["file"]).is_absolute()


@pytest.mark.parametrize(
    ("pair", "match"),
    [
        (("depth", "3"), "takes max_bounces, world, start, threads"),
        (("max_bounces", "many"), "'many' is not a number"),
        (("world", "nan"), "world must be a number from 0"),
        (("world", "-1"), "world must be a number from 0"),
    ],
)
def test_an_invalid_parameter_is_refused(pair, match):
    with pytest.raises(SceneError, match=match):
        CyclesParameters.parse((pair,))


@pytest.mark.parametrize(
    ("name", "cap", "match"),
    [
        ("none.blend", np.inf, "none.blend does not exist"),
        ("a.max", np.inf, "it takes .blend, .usd"),
        ("a.blend", 4.0, "not capped"),
    ],
)
def test_what_cannot_be_rendered_is_refused_without_blender(name, cap, match, tmp_path):
    preset = get_preset("tiny") if cap == np.inf else get_preset("tiny").with_radiance_cap(cap)
    with pytest.raises(SceneError, match=match):
        clip.ensure_cycles(UserSceneOptions(tmp_path / name), preset)


def test_a_changed_buffer_beside_a_gltf_is_noticed(tmp_path):
    file, _ = shared_scene.for_blender(tmp_path)
    parts = scene_file.gltf_parts(file)
    before = scene_file.hash_files(file, parts)
    (tmp_path / "both.bin").write_bytes(b"other")
    assert [Path(part).name for part in parts] == ["both.bin"]
    assert scene_file.hash_files(file, parts) != before


@pytest.mark.parametrize(
    ("name", "tracer"),
    [("a.xml", "mitsuba"), ("a.py", "mitsuba"), ("A.GLB", "mitsuba"), ("a.blend", "cycles")],
)
def test_a_file_goes_to_the_tracer_that_reads_it(name, tracer):
    assert select_tracer(Path(name), None) == tracer


@pytest.fixture
def python(tmp_path, monkeypatch):
    """Replaces the Python that has bpy by a script, which can die in other ways."""

    def install(body):
        script = tmp_path / "python"
        script.write_text(f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
        monkeypatch.setenv(process.PYTHON_VARIABLE, str(script))

    return install


def events(tmp_path, job=None):
    return list(process.run_worker(job or {}, tmp_path / "logs" / "render.log"))


LOG = "echo 'BVH build of Suzanne' >&2"
ENDS = {
    "a fault": (f"{LOG}; kill -SEGV $$", "(?s)SIGSEGV.*segmentation fault.*BVH build of Suzanne"),
    "no memory": (f"{LOG}; kill -KILL $$", "(?s)SIGKILL.*ran out of memory.*BVH build of Suzanne"),
    "an abort": (f"{LOG}; kill -ABRT $$", "(?s)SIGABRT.*aborted.*BVH build of Suzanne"),
    "too early": ("""echo '{"event": "hello"}'""", "exit code 0 before it was done"),
    "half a line": ("""printf '{"event": "ma'; kill -SEGV $$""", "SIGSEGV"),
}


@pytest.mark.parametrize("end", ENDS)
def test_the_error_of_a_process_that_ended_says_how_and_has_the_end_of_its_log(
    python, tmp_path, end
):
    body, message = ENDS[end]
    python(body)
    with pytest.raises(CyclesError, match=message):
        events(tmp_path)


def test_events_arrive_in_order(python, tmp_path):
    python("""echo '{"event": "made", "file": "a", "seconds": 1}'; echo '{"event": "done"}'""")
    assert [event["event"] for event in events(tmp_path)] == ["made", "done"]


def test_the_error_of_a_missing_interpreter_names_the_variable(tmp_path, monkeypatch):
    monkeypatch.setenv(process.PYTHON_VARIABLE, str(tmp_path / "none"))
    with pytest.raises(CyclesError, match=f"{process.PYTHON_VARIABLE}: .*none cannot be run"):
        events(tmp_path)
    assert process.bpy_version() is None


def test_the_error_of_a_python_without_bpy_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setenv(process.PYTHON_VARIABLE, sys.executable)
    if process.bpy_version():
        pytest.skip("this Python has bpy")
    with pytest.raises(CyclesError, match=r"rlbench\[cycles\]"):
        events(tmp_path)


def test_a_caller_that_stops_listening_ends_the_process(python, tmp_path):
    python(f"""echo $$ > {tmp_path}/pid; echo '{{"event": "made"}}'; exec sleep 60""")
    listening = process.run_worker({}, tmp_path / "render.log")
    next(listening)
    listening.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)

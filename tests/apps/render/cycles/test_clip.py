"""Clips of Cycles against Mitsuba's, for every file format, killed and resumed."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import read_clip_arrays
from rlbench.apps.render.cycles import process
from rlbench.apps.render.cycles.clip import ensure_cycles
from rlbench.apps.render.cycles.process import CyclesError
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import render_missing
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.user import camera_path
from rlbench.apps.render.user.clip import UserSceneOptions
from rlbench.checks.result import Verdict
from rlbench.clips.header import read_header
from rlbench.clips.presets import Preset
from rlbench.clips.stored import open_clip, verify
from tests.apps.render.cycles import shared_scene

pytestmark = pytest.mark.slow
H, W = 64, 64
PRESET = Preset("test", "tests", (H, W), shared_scene.FRAMES, reference_spp=40)  # in two spans
SMALL = replace(PRESET, size=(32, 32), frames=2, reference_spp=2, pool_spp=2)
PARAMETERS = (("max_bounces", str(shared_scene.BOUNCES)),)
FORMATS = ("blend", "usd", "glb", "fbx")
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def files(blender, tmp_path_factory):
    """Folder with the scene in every format."""
    folder = tmp_path_factory.mktemp("scene")
    shared_scene.for_blender(folder)
    subprocess.run(
        [blender, "-I", str(HERE / "export_scene.py"), str(folder)], check=True, capture_output=True
    )
    return folder


def make_options(folder, out, **more):
    options = {"exposure": 1.0, "size": (H, W), "parameters": PARAMETERS, **more}
    return UserSceneOptions(folder / "both.gltf", str(folder / "path.json"), out=out, **options)


@pytest.fixture(scope="module")
def cycles(files, tmp_path_factory):
    return ensure_cycles(make_options(files, tmp_path_factory.mktemp("cycles") / "clip"), PRESET)


@pytest.fixture(scope="module")
def mitsuba(tmp_path_factory):
    matrices = [camera_path.matrix_from_camera(shared_scene.camera(t)) for t in range(4)]
    path = camera_path.follow_matrices(matrices)  # before frame 0, nothing moves, as in the file
    scene = replace(
        shared_scene.for_mitsuba(),
        camera=lambda time: camera_path.camera_from_matrix(path(time), shared_scene.FOV),
    )
    job = Job("both", scene, PRESET, tmp_path_factory.mktemp("mitsuba") / "clip")
    return render_missing([job])[0]


@pytest.mark.parametrize("tracer", ["cycles", "mitsuba"])
def test_the_linter_finds_no_fault(tracer, llvm, request):
    results = lint_clip(read_clip_arrays(request.getfixturevalue(tracer)))
    assert not [result for result in results if result.verdict is Verdict.FAILED]


@pytest.mark.parametrize("index", range(shared_scene.FRAMES))
def test_diffuse_surfaces_are_as_bright_as_mitsubas(cycles, mitsuba, llvm, index):
    ours, theirs = (open_clip(clip).frame(index) for clip in (cycles, mitsuba))
    visible = (theirs.gbuffer.albedo.sum(1, keepdim=True) > 0).expand_as(theirs.gbuffer.albedo)
    means, errors = [], []
    for frame in (ours, theirs):
        noise = (frame.reference.half_a - frame.reference.half_b)[visible] / 2
        means.append(float(frame.reference.mean[visible].mean()))
        errors.append(float(noise.double().square().mean().sqrt()) / int(visible.sum()) ** 0.5)
    # 4 standard errors of the difference of two means, noise of pixels being independent
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors)


@pytest.mark.parametrize(
    ("name", "tolerance"), [("normal", 1e-3), ("motion", 1e-2), ("depth", 2e-3)]
)
def test_geometry_equals_mitsubas(cycles, mitsuba, llvm, name, tolerance):
    # half precision of normals, float32 matrices; pixels at edges may see another surface
    ours, theirs = (open_clip(clip).frame(2).gbuffer.buffers[name] for clip in (cycles, mitsuba))
    difference = (ours - theirs).abs().amax(1)
    assert float((difference > tolerance).float().mean()) < 5e-3


def test_the_header_records_the_renderer(cycles):
    header = read_header(cycles)
    renderer = (header.sampler, header.sampler_version, header.stratified, header.pool_spp)
    assert renderer == ("cycles", "Blender 4.5.15 LTS, 6 bounces, light tree", True, 8)
    assert header.sample_ms > 0


def test_a_finished_clip_needs_no_blender(cycles, files, monkeypatch):
    assert verify(cycles) == []
    monkeypatch.setenv(process.PYTHON_VARIABLE, "/nowhere")
    assert ensure_cycles(make_options(files, cycles), PRESET) == cycles


def test_samples_are_antialiased(cycles, mitsuba, llvm):
    # sample 0 alone would not converge: its mean would be off at edges by far more than noise
    clip = open_clip(cycles)
    frame = clip.frame(1)
    pool = frame.pool.read(frame.pool.empty(), frame.pool.empty().counts + 8)[0]
    error = (pool.mean(0) - frame.reference.half_a[0]) * (pool.mean(0) - frame.reference.half_b[0])
    expected = pool.var(0) / len(pool)
    weight = 1 / (frame.reference.mean[0] + 0.05) ** 2
    ratio = float((error * weight).mean() / (expected * weight).mean())
    assert ratio == pytest.approx(1, abs=0.25)  # without anti-aliasing it was 22


def test_a_killed_rendering_resumes_to_the_same_pixels(cycles, files, tmp_path):
    out, log = tmp_path / "clip", tmp_path / "log"
    code = (
        "from tests.apps.render.cycles.test_clip import *; import sys;"
        "ensure_cycles(make_options(Path(sys.argv[1]), Path(sys.argv[2])), PRESET)"
    )
    with log.open("wb") as stderr:
        rendering = subprocess.Popen(
            [sys.executable, "-c", code, str(files), str(out)], stderr=stderr, cwd=HERE.parents[3]
        )
        while rendering.poll() is None and not list(out.glob(".cycles/path.*.3.exr")):
            pass
        rendering.send_signal(signal.SIGKILL)
        assert rendering.wait() == -signal.SIGKILL, log.read_text()
    assert not (out / "clip.toml").exists()
    resumed = ensure_cycles(make_options(files, out), PRESET)
    for file in cycles.glob("*.exr"):
        assert (resumed / file.name).read_bytes() == file.read_bytes(), file.name
    assert not (resumed / ".cycles").exists()


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_has_the_camera_the_shapes_and_their_motion(kind, files, tmp_path, llvm):
    options = UserSceneOptions(
        files / f"both.{kind}", "", size=SMALL.size, exposure=1.0, out=tmp_path / "clip"
    )
    gbuffer = open_clip(ensure_cycles(options, SMALL)).frame(1).gbuffer
    tracer = open_tracer(shared_scene.for_mitsuba(), *SMALL.size)
    tracer.set_time(1.0)
    for name, expected in render_gbuffer(tracer, ("depth", "motion")).items():
        difference = np.abs(gbuffer.buffers[name][0].permute(1, 2, 0).numpy() - expected).max(-1)
        assert (difference > 1e-2).mean() < 0.01, name  # pixels at edges may see another surface


def test_a_still_camera_and_static_meshes_make_a_static_clip(files, tmp_path):
    still = files / "still.gltf"
    text = (files / "both.gltf").read_text()
    still.write_text(text.replace('"animations"', '"extras"'))
    path = tmp_path / "one.json"
    options = make_options(files, tmp_path / "clip", size=SMALL.size)
    first = camera_path.matrix_from_camera(shared_scene.camera(0)).tolist()
    path.write_text(json.dumps({"camera_to_world": [first] * 2, "fov": shared_scene.FOV}))
    header = read_header(ensure_cycles(replace(options, file=still, camera=str(path)), SMALL))
    assert header.static
    assert "motion" not in header.buffers


def test_a_scene_without_light_is_refused_before_anything_is_written(files, tmp_path):
    dark = files / "dark.gltf"
    dark.write_text((files / "both.gltf").read_text().replace("emissiveFactor", "extras"))
    options = replace(make_options(files, tmp_path / "clip"), file=dark)
    with pytest.raises(SceneError, match="frames 0, 1.* are black.*world=1"):
        ensure_cycles(replace(options, exposure=None), SMALL)
    assert not (tmp_path / "clip").exists()


def test_the_error_of_a_broken_file_has_blenders_message(blender, tmp_path):
    file = tmp_path / "broken.blend"
    file.write_bytes(b"BLENDER-v405 and nothing more")
    with pytest.raises(CyclesError, match=r"Blender: .*broken\.blend"):
        ensure_cycles(UserSceneOptions(file, out=tmp_path / "clip"), SMALL)


def test_a_worker_that_is_killed_is_a_crash(files, tmp_path):
    job = {"scene": str(files / "both.blend"), "frames": 2000, "start": 0, "size": None}
    events = process.run_worker({**job, "renders": []}, tmp_path / "log.txt")
    assert next(events)["event"] == "hello"
    children = subprocess.run(
        ["pgrep", "-P", str(os.getpid()), "-f", "worker.py"], capture_output=True, text=True
    )
    os.kill(int(children.stdout.split()[0]), signal.SIGSEGV)
    with pytest.raises(CyclesError, match=r"SIGSEGV.*segmentation fault"):
        list(events)

"""Rendering clips: what is missing, what is kept, which takes, and remeasured times."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.live_pool import open_live_clip
from rlbench.apps.render.jobs.render_clips import (
    preset_jobs,
    remeasure_sample_ms,
    render_clip,
    render_missing,
    scene_of_clip,
)
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import SceneError
from rlbench.clips.header import ClipError, read_header, write_header
from rlbench.clips.presets import PRESETS, Preset
from rlbench.clips.stored import open_clip, verify
from rlbench.ops.reprojection import reproject
from tests.apps.render.conftest import install_scene, own_cache
from tests.apps.render.small_scenes import diffuse, room, room_with_takes

PRESET = Preset("test", "tests", (16, 24), frames=3, reference_spp=2, pool_spp=3)
TAKES_PRESET = Preset("test", "tests", (16, 24), 4, 2, ("room",), pool_spp=2, takes="all")


def job(folder, scene=None, preset=PRESET):
    return Job("room", scene or room(), preset, folder)


def contents(folder, pattern="*.exr"):
    return {file.name: file.read_bytes() for file in sorted(folder.glob(pattern))}


@pytest.fixture(scope="module")
def rendered(usable_llvm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "room"
    with own_cache(tmp_path_factory):
        render_clip(job(folder))
    return folder


@pytest.fixture
def clip(llvm, rendered, tmp_path):
    return shutil.copytree(rendered, tmp_path / "room")


class Killed(BaseException):
    """Interrupts a rendering."""


def killer(after):
    calls = iter(range(after))

    def traced(*samples):
        if next(calls, None) is None:
            raise Killed

    return traced


@pytest.mark.parametrize(
    "after", [*(pytest.param(n, marks=pytest.mark.slow) for n in (0, 2)), 4, 7]
)
def test_an_interrupted_clip_is_unfinished_and_resumes_to_the_same_files(clip, tmp_path, after):
    resumed = tmp_path / "again"
    with pytest.raises(Killed):
        render_clip(job(resumed), killer(after))
    assert not (resumed / "clip.toml").exists()
    render_clip(job(resumed))
    assert contents(resumed) == contents(clip)
    assert (resumed / "clip.toml").exists()


def test_a_lost_file_is_rendered_again_and_the_others_are_left_alone(clip):
    before = contents(clip)
    written_ns = (clip / "view.0000.exr").stat().st_mtime_ns
    (clip / "referenceA.0001.exr").unlink()
    assert not job(clip).is_finished
    render_clip(job(clip))
    assert contents(clip) == before
    assert (clip / "view.0000.exr").stat().st_mtime_ns == written_ns


def test_a_rendered_clip_passes_verification_and_its_header_describes_it(clip):
    assert verify(clip) == []
    header = read_header(clip)
    assert (header.height, header.width, header.frames, header.pool_spp) == (16, 24, 3, 3)
    assert header.reference_spp == (4, 4, 4)
    assert header.sample_ms > 0


def test_stored_samples_are_those_of_the_tracer_before_exposure(clip):
    tracer = open_tracer(room(), 16, 24)
    tracer.set_time(1.0)
    stored = open_clip(clip).frame(1).pool.radiance[0].permute(0, 2, 3, 1).numpy() / 2.0
    stack = tracer.trace_images(3)
    # sorted, because the clip has its own sample order; half precision has 11 bits
    np.testing.assert_allclose(np.sort(stored, 0), np.sort(stack, 0), rtol=2**-10, atol=1e-6)
    reference = open_clip(clip).frame(0).reference
    assert not (reference.half_a == reference.half_b).all()  # of different paths


EXTRAS = ("object", "albedo_first", "normal_psr", "depth_psr", "object_psr")


def test_extra_buffers_are_in_the_clip(llvm, tmp_path):
    render_clip(job(tmp_path, preset=PRESET.with_buffers(EXTRAS)))
    assert verify(tmp_path) == []
    gbuffer = open_clip(tmp_path, inputs=frozenset(EXTRAS)).frame(1).gbuffer
    tracer = open_tracer(room(), 16, 24)
    tracer.set_time(1.0)
    for name, expected in render_gbuffer(tracer, EXTRAS).items():
        buffer = gbuffer.extra(name)[0].permute(1, 2, 0).numpy()
        np.testing.assert_allclose(buffer, expected, atol=2**-11, err_msg=name)  # half, up to 1


def test_a_changed_scene_replaces_its_frames(clip):
    before = contents(clip)
    painted = replace(room().meshes[0], material=diffuse(0.9, 0.1, 0.1))
    changed = replace(room(), meshes=(painted, *room().meshes[1:]))
    assert not job(clip, changed).is_finished
    render_clip(job(clip, changed))
    assert not set(contents(clip).values()) & {before["view.0000.exr"], before["view.0002.exr"]}


def test_frames_of_another_renderer_are_not_removed(llvm, tmp_path):
    (tmp_path / "view.0000.exr").write_bytes(b"somebody's work")
    with pytest.raises(ClipError, match="did not write"):
        render_clip(job(tmp_path))
    assert (tmp_path / "view.0000.exr").exists()


def test_a_cap_dims_inputs_and_references_alike_and_is_in_the_header(clip, tmp_path):
    render_clip(job(tmp_path / "capped", preset=PRESET.with_radiance_cap(0.25)))
    assert read_header(tmp_path / "capped").radiance_cap == 0.25
    free, capped = (open_clip(folder).frame(1) for folder in (clip, tmp_path / "capped"))
    assert free.pool.radiance.max() > 1
    assert free.reference.half_a.max() > 1
    # half precision has 11 bits; the header's exposure is a power of two
    assert capped.pool.radiance.max() <= 0.25 * (1 + 2**-10)
    assert capped.reference.half_a.max() <= 0.25 * (1 + 1e-6)


def test_content_keys_of_existing_clips_have_not_changed():
    # as in scene.txt of clips that were rendered before rounds and caps existed
    for name, expected in (("mini", "192x192 8 frames"), ("train", "160x160 5 frames")):
        key = job("a", preset=PRESETS[name]).content_key
        assert key.endswith(f" {expected} 8 + 2 x 64 spp\n")


def test_a_generated_scene_comes_from_the_registry_with_its_seed():
    scene = registry.load_plugin("scenes", "generated")(7)
    assert scene_of_clip("generated-007").name == scene.name == "generated-7"


@pytest.mark.parametrize("name", ["generated", "generated-cut", "eventful"])
def test_a_generated_scene_without_a_seed_is_an_error(name):
    with pytest.raises(SceneError, match=f"'{name}' is not a generated scene; give a seed"):
        scene_of_clip(name)


@pytest.fixture
def installed(monkeypatch):
    install_scene(monkeypatch, "room", room_with_takes)


@pytest.fixture(scope="module")
def clips(usable_llvm, tmp_path_factory):
    with own_cache(tmp_path_factory), pytest.MonkeyPatch.context() as patch:
        install_scene(patch, "room", room_with_takes)
        jobs = preset_jobs(TAKES_PRESET, folder=tmp_path_factory.mktemp("takes"))
        return {folder.name: folder for folder in render_missing(jobs)}


def test_a_preset_of_all_takes_renders_a_clip_for_each_with_the_name_of_the_scene(clips):
    assert list(clips) == ["room", "room-cut", "room-still"]
    headers = [read_header(folder) for folder in clips.values()]
    assert [(header.scene, header.name) for header in headers] == [("room", n) for n in clips]


@pytest.mark.parametrize(
    ("takes", "scenes", "clip_names"),
    [
        ("main", ["room"], ["room"]),
        ("main", ["room-cut"], ["room-cut"]),
        ("all", ["room-cut"], ["room-cut"]),
        ("all", ["room-cut", "room"], ["room-cut", "room", "room-still"]),
    ],
)
def test_a_scene_name_selects_the_takes_of_the_preset_and_a_clip_name_one_take(
    installed, takes, scenes, clip_names
):
    jobs = preset_jobs(replace(TAKES_PRESET, takes=takes), scenes)
    assert [job.name for job in jobs] == clip_names


def test_the_header_records_light_changes_cuts_and_that_nothing_moves(clips):
    headers = {name: read_header(folder) for name, folder in clips.items()}
    found = {name: (h.light_changes, h.cuts, h.static) for name, h in headers.items()}
    still = ((), (), True)
    assert found == {"room": ((), (), False), "room-cut": ((3,), (2,), False), "room-still": still}
    assert "motion" not in headers["room-still"].buffers


def test_motion_leads_every_pixel_outside_at_a_cut_and_only_there(clips):
    clip = open_clip(clips["room-cut"])
    history = torch.zeros(1, 1, 16, 24)
    shares = [float(reproject(history, f.gbuffer.motion)[1].float().mean()) for f in clip]
    assert shares[2] == 0
    assert min(shares[1], shares[3]) > 0.5


@pytest.mark.parametrize(("time", "outside"), [(1.5, False), (2.5, True), (3.0, False)])
def test_between_frames_a_cut_lasts_while_the_previous_frame_shows_the_other_shot(
    llvm, time, outside
):
    tracer = open_tracer(room_with_takes().select_take("cut"), 8, 12)
    tracer.set_time(time)
    motion = render_gbuffer(tracer, ("motion",))["motion"]
    assert bool((motion == np.array([-24, -16], np.float32)).all()) is outside


def test_a_switched_light_changes_radiance_and_not_the_gbuffer(clips):
    two, three = (open_clip(clips["room-cut"]).frame(i) for i in (2, 3))
    assert float(three.reference.half_a.mean()) < 0.8 * float(two.reference.half_a.mean())
    still = two.gbuffer.normal == three.gbuffer.normal
    assert float(still.float().mean()) > 0.8  # but for the cube, which moves


def test_live_samples_of_a_take_equal_the_stored_ones(llvm, installed, clips):
    stored = open_clip(clips["room-cut"])
    for stored_frame, live_frame in zip(stored, open_live_clip(stored), strict=True):
        counts = torch.full((1, 1, 16, 24), 2)
        stored_radiance, live_radiance = (
            pool.read(pool.empty(), counts) for pool in (stored_frame.pool, live_frame.pool)
        )
        # but where Embree's choice depends on neighbouring rays: see WavefrontTracer
        assert float((stored_radiance != live_radiance).double().mean()) < 0.01


def test_remeasuring_changes_the_times_per_sample_and_nothing_else(clip, installed):
    before = read_header(clip)
    slow = replace(before, sample_ms=1e6, pools=("path", "restir"), pools_ms=(1e6, 3e6))
    write_header(clip, slow)
    now = remeasure_sample_ms(clip)
    assert now == read_header(clip)
    assert 0 < now.sample_ms < 1e5  # 384 pixels: a millisecond or two
    assert now.pools_ms == pytest.approx((now.sample_ms, 3 * now.sample_ms))
    assert 0 < now.sample_p5_ms <= now.sample_ms <= now.sample_p95_ms
    assert now.gbuffer_ms > 0
    assert now.timed_with.endswith(" threads")
    times = ("sample_ms", "pools_ms", "sample_p5_ms", "sample_p95_ms", "gbuffer_ms")
    assert replace(now, **{name: getattr(slow, name) for name in times}) == slow


def test_a_clip_of_another_machine_is_not_remeasured(clip):
    write_header(clip, replace(read_header(clip), device="abacus"))
    with pytest.raises(ClipError, match="was rendered on 'abacus'.*times samples on this machine"):
        remeasure_sample_ms(clip)


@pytest.mark.parametrize("path", [("path",), ("path", "restir")])
def test_first_frames_are_those_of_the_whole_clip_which_is_finished_later(llvm, tmp_path, path):
    preset = replace(PRESET, frames=4, pools=path)
    whole, part = job(tmp_path / "whole", preset=preset), job(tmp_path / "part", preset=preset)
    render_missing([whole])
    first = replace(part, limit_frames=2)
    render_missing([first])
    assert len(open_clip(part.folder)) == 2
    assert verify(part.folder) == []
    assert contents(part.folder).items() < contents(whole.folder).items()
    assert open_clip(part.folder).digest == open_clip(whole.folder, limit_frames=2).digest
    assert first.is_finished
    assert not part.is_finished
    written_ns = {file: file.stat().st_mtime_ns for file in part.folder.glob("*.exr")}
    render_missing([part])
    assert contents(part.folder) == contents(whole.folder)
    assert {file: file.stat().st_mtime_ns for file in written_ns} == written_ns
    assert open_clip(part.folder).digest == open_clip(whole.folder).digest
    (part.folder / "view.0000.exr").unlink()
    render_missing([first])  # a whole clip stays one
    assert contents(part.folder) == contents(whole.folder)
    assert len(open_clip(part.folder)) == 4
    assert read_header(part.folder).pools == path

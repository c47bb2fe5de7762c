"""Rendering clips to folders."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.clips.stored import ClipError, open_clip, read_header, verify
from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.job import Job
from rlbench.render.jobs.render_clips import ensure, render
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import PRESETS, Preset, preset
from tests.render.worlds import diffuse, room, square

PLAN = Preset("test", "tests", (16, 24), frames=3, reference_spp=2, pool_spp=3)


def job(folder, scene=None, plan=PLAN):
    return Job("room", scene or room(), plan, folder)


def contents(folder):
    return {file.name: file.read_bytes() for file in sorted(folder.glob("*.exr"))}


@pytest.fixture
def clip(llvm, tmp_path):
    render(job(tmp_path / "room"))
    return tmp_path / "room"


class Killed(BaseException):
    """What ends a rendering in the middle."""


def killer(after):
    calls = iter(range(after))

    def traced(samples):
        if next(calls, None) is None:
            raise Killed

    return traced


@pytest.mark.parametrize("after", [0, 2, 4, 7])
def test_an_interrupted_clip_is_unfinished_and_resumes_to_the_same_files(clip, tmp_path, after):
    again = tmp_path / "again"
    with pytest.raises(Killed):
        render(job(again), killer(after))
    assert not (again / "clip.toml").exists()
    render(job(again))
    assert contents(again) == contents(clip)
    assert (again / "clip.toml").exists()


def test_a_lost_file_is_rendered_again_and_the_others_are_left_alone(clip):
    before = contents(clip)
    kept = (clip / "view.0000.exr").stat().st_mtime_ns
    (clip / "referenceA.0001.exr").unlink()
    assert not job(clip).finished
    render(job(clip))
    assert contents(clip) == before
    assert (clip / "view.0000.exr").stat().st_mtime_ns == kept


def test_what_is_written_is_a_sound_clip(clip):
    assert verify(clip) == []


def test_the_header_says_what_was_rendered(clip):
    header = read_header(clip)
    assert (header.height, header.width, header.frames, header.pool_spp) == (16, 24, 3, 3)
    assert header.reference_spp == (4, 4, 4)
    assert header.sample_ms > 0


def test_stored_samples_are_those_of_the_tracer_before_exposure(clip):
    tracer = open_tracer(room(), 16, 24)
    tracer.set_time(1.0)
    sold = open_clip(clip).frame(1).pool.radiance[0].permute(0, 2, 3, 1).numpy() / 2.0
    stack = tracer.stack(3)
    # sorted, as the clip sells them in an order of its own; half precision has 11 bits
    np.testing.assert_allclose(np.sort(sold, 0), np.sort(stack, 0), rtol=2**-10, atol=1e-6)


def test_halves_of_the_reference_are_other_paths(clip):
    reference = open_clip(clip).frame(0).reference
    assert not (reference.half_a == reference.half_b).all()


def test_a_static_scene_has_no_motion_buffer(llvm, tmp_path):
    render(job(tmp_path, room(static=True), replace(PLAN, frames=1)))
    assert read_header(tmp_path).static
    assert "motion" not in read_header(tmp_path).buffers


EXTRAS = ("object", "albedo_first", "normal_psr", "depth_psr", "object_psr")


def test_view_buffers_that_were_asked_for_are_in_the_clip(llvm, tmp_path):
    render(job(tmp_path, plan=PLAN.with_buffers(EXTRAS)))
    assert verify(tmp_path) == []
    gbuffer = open_clip(tmp_path, inputs=frozenset(EXTRAS)).frame(1).gbuffer
    tracer = open_tracer(room(), 16, 24)
    tracer.set_time(1.0)
    for name, expected in render_gbuffer(tracer, EXTRAS).items():
        found = gbuffer.extra(name)[0].permute(1, 2, 0).numpy()
        np.testing.assert_allclose(found, expected, atol=2**-11, err_msg=name)  # half, up to 1


def test_a_clip_without_them_says_so(clip):
    with pytest.raises(ClipError, match="no buffer object; it has: albedo, normal, depth, motion"):
        open_clip(clip, inputs=frozenset({"object"}))


def test_clips_with_more_buffers_are_another_set():
    more = PRESETS["mini"].with_buffers(["object"])
    assert more.name == "mini-views"
    assert job("a", plan=more).content_key != job("a", plan=PRESETS["mini"]).content_key


def test_a_buffer_that_cannot_be_added_is_an_error_that_lists_those_there_are():
    with pytest.raises(ValueError, match="no view buffer emission to add; there are: object"):
        PRESETS["mini"].with_buffers(["object", "emission"])


def test_a_changed_scene_replaces_its_frames(clip):
    before = contents(clip)
    painted = replace(room().meshes[0], material=diffuse(0.9, 0.1, 0.1))
    changed = replace(room(), meshes=(painted, *room().meshes[1:]))
    assert not job(clip, changed).finished
    render(job(clip, changed))
    assert not set(contents(clip).values()) & {before["view.0000.exr"], before["view.0002.exr"]}


def test_frames_of_a_changed_scene_count_as_missing(clip):
    assert job(clip).missing == []
    assert job(clip, replace(room(), depth=3)).missing == [0, 1, 2]


def test_frames_of_another_origin_are_not_removed(llvm, tmp_path):
    (tmp_path / "view.0000.exr").write_bytes(b"somebody's work")
    with pytest.raises(ClipError, match="did not write"):
        render(job(tmp_path))
    assert (tmp_path / "view.0000.exr").exists()


def test_a_fingerprint_ignores_the_last_bit_of_a_number():
    jitter = replace(room().meshes[1], vertices=room().meshes[1].vertices * np.float32(1 + 1e-7))
    other = replace(room(), meshes=(room().meshes[0], jitter, *room().meshes[2:]))
    assert fingerprint(room(), 8) == fingerprint(other, 8)


def test_a_fingerprint_notices_a_new_mesh():
    more = replace(room(), meshes=(*room().meshes, square("new", 1.0, 2.0, diffuse(0, 0, 0))))
    assert fingerprint(room(), 8) != fingerprint(more, 8)


def test_an_unknown_scene_is_an_error_that_lists_those_there_are(tmp_path):
    with pytest.raises(LookupError, match="temple"):
        ensure("tiny", scenes=["atlantis"], folder=tmp_path)


def test_an_unknown_preset_is_an_error_that_lists_those_there_are():
    with pytest.raises(LookupError, match="mini"):
        preset("huge")


def test_the_papers_protocol():
    paper = PRESETS["paper"]
    assert (paper.size, paper.frames, paper.pool_spp) == ((720, 720), 20, 8)
    assert 2 * paper.reference_spp == 1000
    assert paper.clip_samples == 20 * 720 * 720 * 1008


def test_a_capped_preset_is_another_set_of_clips():
    capped = PRESETS["mini"].capped(64.0)
    assert capped.name == "mini-cap64"
    assert job("a", plan=capped).content_key != job("a", plan=PRESETS["mini"]).content_key


@pytest.mark.parametrize("cap", [0.0, -1.0, float("nan")])
def test_a_cap_that_leaves_no_light_is_told(cap):
    with pytest.raises(ValueError, match="must be above 0"):
        PRESETS["mini"].capped(cap)


def test_a_cap_dims_inputs_and_references_alike_and_is_in_the_header(clip, tmp_path):
    render(job(tmp_path / "capped", plan=PLAN.capped(0.25)))
    assert read_header(tmp_path / "capped").radiance_cap == 0.25
    free, capped = (open_clip(folder).frame(1) for folder in (clip, tmp_path / "capped"))
    assert free.pool.radiance.max() > 1
    assert free.reference.half_a.max() > 1
    # half precision has 11 bits; the header's exposure is a power of two
    assert capped.pool.radiance.max() <= 0.25 * (1 + 2**-10)
    assert capped.reference.half_a.max() <= 0.25 * (1 + 1e-6)


def test_presets_of_clips_in_use_keep_their_mark():
    # what stands in scene.txt of clips that were rendered before there were rounds and caps
    assert job("a", plan=PRESETS["mini"]).content_key.endswith(" 192x192 8 frames 8 + 2 x 64 spp\n")
    assert job("a", plan=PRESETS["train"]).content_key.endswith(
        " 160x160 5 frames 8 + 2 x 64 spp\n"
    )

"""Takes of a scene: what of it they change, their clips, and what a cut does to motion."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.clips.stored import ClipError, open_clip, read_header, write_header
from rlbench.ops.reprojection import reproject
from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.live_pool import open_live
from rlbench.render.jobs.render_clips import ensure, scene_of_clip
from rlbench.render.jobs.retime import remeasure_sample_ms
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import PRESETS, Preset
from rlbench.render.scene import Camera, SceneError, Take
from tests.render.small_scenes import room

PLAN = Preset("test", "tests", (16, 24), 4, 2, ("room",), pool_spp=2, takes="all")
AWAY = Camera((4.0, -4.0, 1.5), (0, 0, 0.5), fov=50.0)


def filmed():
    """The room with two takes: after a cut its lamp goes out, or all stands still."""
    first = room().camera
    shots = Take(
        "cut",
        lambda time: first(time) if time < 2 else AWAY,
        lights=lambda time: {"lamp": 1.0 if time < 3 else 0.0},
        cuts=(2, 9),
    )
    still = Take("still", lambda time: AWAY, moving=lambda time: {}, static=True)
    return replace(room(), takes=(shots, still))


@pytest.fixture
def installed(monkeypatch):
    monkeypatch.setattr(registry, "names", lambda group: ["room"])
    monkeypatch.setattr(registry, "load", lambda group, name: filmed)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("takes")


@pytest.fixture
def clips(llvm, installed, place):
    return {folder.name: folder for folder in ensure(PLAN, folder=place)}  # rendered once


def test_a_take_is_the_scene_but_for_what_it_says():
    scene, take = filmed(), filmed().select_take("still")
    assert [mesh.name for mesh in take.meshes] == [mesh.name for mesh in scene.meshes]
    assert (take.name, take.sky, take.exposure, take.depth) == ("room", scene.sky, 2.0, 8)
    assert (take.static, take.camera(7.0), take.vertex_animation(7.0), take.takes) == (
        True,
        AWAY,
        {},
        (),
    )


def test_a_take_that_says_nothing_of_motion_moves_as_the_scene():
    scene = filmed()
    assert np.array_equal(
        scene.select_take("cut").vertex_animation(3.0)["cube"], scene.vertex_animation(3.0)["cube"]
    )


def test_an_unknown_take_is_an_error_that_lists_those_there_are(installed):
    with pytest.raises(SceneError, match="scene 'room' has no take 'crane'; it has: cut, still"):
        scene_of_clip("room-crane")


def test_a_preset_of_all_takes_has_a_clip_of_each_and_the_scene_is_told(clips):
    assert list(clips) == ["room", "room-cut", "room-still"]
    assert {read_header(folder).scene for folder in clips.values()} == {"room"}
    assert [read_header(folder).name for folder in clips.values()] == list(clips)


@pytest.mark.parametrize(
    ("takes", "asked", "made"),
    [
        ("main", ["room"], ["room"]),
        ("main", ["room-cut"], ["room-cut"]),
        ("all", ["room-cut"], ["room-cut"]),
        ("all", ["room-cut", "room"], ["room-cut", "room", "room-still"]),
    ],
)
def test_a_scene_stands_for_takes_of_the_preset_and_a_clip_for_itself(
    installed, monkeypatch, tmp_path, takes, asked, made
):
    monkeypatch.setattr(
        "rlbench.render.jobs.render_clips._render_all", lambda jobs, bar, engine: None
    )
    folders = ensure(replace(PLAN, takes=takes), asked, folder=tmp_path)
    assert [folder.name for folder in folders] == made


def test_the_estimate_counts_all_takes(llvm, installed, tmp_path, capsys):
    ensure(replace(PLAN, size=(4, 6), frames=1, reference_spp=1), folder=tmp_path)
    assert "rendering 3 clips of preset test" in capsys.readouterr().err.replace("\n", " ")


def test_the_header_tells_the_cuts_that_the_clip_has(clips):
    cuts = {name: read_header(folder).cuts for name, folder in clips.items()}
    assert cuts == {"room": (), "room-cut": (2,), "room-still": ()}


def test_at_a_cut_every_pixel_comes_from_outside_and_only_there(clips):
    clip = open_clip(clips["room-cut"])
    history = torch.zeros(1, 1, 16, 24)
    shares = [float(reproject(history, f.gbuffer.motion)[1].float().mean()) for f in clip]
    assert shares[2] == 0
    assert min(shares[1], shares[3]) > 0.5


@pytest.mark.parametrize(("time", "outside"), [(1.5, False), (2.5, True), (3.0, False)])
def test_between_frames_a_cut_lasts_as_long_as_the_frame_before_is_of_the_other_shot(
    llvm, time, outside
):
    tracer = open_tracer(filmed().select_take("cut"), 8, 12)
    tracer.set_time(time)
    motion = render_gbuffer(tracer, ("motion",))["motion"]
    assert bool((motion == np.array([-24, -16], np.float32)).all()) is outside


def test_a_still_take_has_no_motion_buffer(clips):
    header = read_header(clips["room-still"])
    assert header.static
    assert "motion" not in header.buffers


def test_a_switched_light_is_seen_in_its_frame_and_in_no_buffer(clips):
    two, three = (open_clip(clips["room-cut"]).frame(i) for i in (2, 3))
    assert float(three.reference.half_a.mean()) < 0.8 * float(two.reference.half_a.mean())
    still = two.gbuffer.normal == three.gbuffer.normal
    assert float(still.float().mean()) > 0.8  # but for the cube, which moves


def test_a_take_is_sampled_live_as_it_was_stored(clips):
    stored = open_clip(clips["room-cut"])
    for one, other in zip(stored, open_live(stored), strict=True):
        counts = torch.full((1, 1, 16, 24), 2)
        whole, traced = (pool.read(pool.empty(), counts) for pool in (one.pool, other.pool))
        # but for what Embree decides by the rays around: see Wavefront
        assert float((whole != traced).double().mean()) < 0.01


def test_what_a_scene_offers_besides_does_not_change_its_main_clip():
    assert fingerprint(filmed(), 8) == fingerprint(room(), 8)


@pytest.mark.parametrize(
    "change",
    [
        {"lights": lambda time: {"lamp": 0.5 if time == 3 else 1.0}},
        {"cuts": (2,)},
        {"camera": lambda time: AWAY if time in (1.0, 2.0) else room().camera(time), "cuts": (2,)},
    ],
    ids=["lights", "cuts", "camera"],
)
def test_a_fingerprint_notices_lights_and_cuts(change):
    assert fingerprint(replace(room(), **change), 8) != fingerprint(room(), 8)


def test_mini_has_main_takes_only_and_standard_has_all():
    takes = {name: PRESETS[name].takes for name in ("mini", "standard", "paper")}
    assert takes == {"mini": "main", "standard": "all", "paper": "main"}


def test_retiming_measures_a_sample_anew_and_touches_nothing_else(clips):
    folder = clips["room-cut"]
    before = read_header(folder)
    slow = replace(before, sample_ms=1e6, pools=("path", "restir"), pools_ms=(1e6, 3e6))
    write_header(folder, slow)
    now = remeasure_sample_ms(folder)
    assert now == read_header(folder)
    assert 0 < now.sample_ms < 1e5  # 384 pixels: a millisecond or two
    assert now.pools_ms == pytest.approx((now.sample_ms, 3 * now.sample_ms))
    assert replace(now, sample_ms=1e6, pools_ms=slow.pools_ms) == slow
    write_header(folder, before)


def test_what_another_machine_has_rendered_is_not_retimed(clips):
    folder = clips["room"]
    before = read_header(folder)
    write_header(folder, replace(before, device="abacus"))
    with pytest.raises(ClipError, match="was rendered on 'abacus'.*times its samples here"):
        remeasure_sample_ms(folder)
    write_header(folder, before)

"""Clips of takes: names, headers, motion at cuts, and live samples."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.clips.stored import open_clip, read_header
from rlbench.ops.reprojection import reproject
from rlbench.render.jobs.live_pool import open_live_clip
from rlbench.render.jobs.render_clips import ensure, scene_of_clip
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import Preset
from rlbench.render.scene import SceneError
from tests.render.small_scenes import room_with_takes

PRESET = Preset("test", "tests", (16, 24), 4, 2, ("room",), pool_spp=2, takes="all")


@pytest.fixture
def installed(monkeypatch):
    monkeypatch.setattr(registry, "list_plugins", lambda group: ["room"])
    monkeypatch.setattr(registry, "load_plugin", lambda group, name: room_with_takes)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("takes")


@pytest.fixture
def clips(llvm, installed, place):
    return {folder.name: folder for folder in ensure(PRESET, folder=place)}  # rendered once


def test_an_unknown_take_is_an_error_that_lists_the_available_ones(installed):
    with pytest.raises(
        SceneError, match="scene 'room' has no take 'crane'; available takes: cut, still"
    ):
        scene_of_clip("room-crane")


def test_a_preset_of_all_takes_renders_a_clip_for_each_with_the_name_of_the_scene(clips):
    assert list(clips) == ["room", "room-cut", "room-still"]
    assert {read_header(folder).scene for folder in clips.values()} == {"room"}
    assert [read_header(folder).name for folder in clips.values()] == list(clips)


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
    installed, monkeypatch, tmp_path, takes, scenes, clip_names
):
    monkeypatch.setattr(
        "rlbench.render.jobs.render_clips._render_all", lambda jobs, bar, executor: None
    )
    folders = ensure(replace(PRESET, takes=takes), scenes, folder=tmp_path)
    assert [folder.name for folder in folders] == clip_names


def test_the_estimate_counts_all_takes(llvm, installed, tmp_path, capsys):
    ensure(replace(PRESET, size=(4, 6), frames=1, reference_spp=1), folder=tmp_path)
    assert "rendering 3 clips of preset test" in capsys.readouterr().err.replace("\n", " ")


def test_the_header_records_the_light_changes_of_the_clip(clips):
    changes = {name: read_header(folder).light_changes for name, folder in clips.items()}
    assert changes == {"room": (), "room-cut": (3,), "room-still": ()}


def test_the_header_records_the_cuts_of_the_clip(clips):
    cuts = {name: read_header(folder).cuts for name, folder in clips.items()}
    assert cuts == {"room": (), "room-cut": (2,), "room-still": ()}


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


def test_a_still_take_has_no_motion_buffer(clips):
    header = read_header(clips["room-still"])
    assert header.static
    assert "motion" not in header.buffers


def test_a_switched_light_changes_radiance_and_not_the_gbuffer(clips):
    two, three = (open_clip(clips["room-cut"]).frame(i) for i in (2, 3))
    assert float(three.reference.half_a.mean()) < 0.8 * float(two.reference.half_a.mean())
    still = two.gbuffer.normal == three.gbuffer.normal
    assert float(still.float().mean()) > 0.8  # but for the cube, which moves


def test_live_samples_of_a_take_equal_the_stored_ones(clips):
    stored = open_clip(clips["room-cut"])
    for stored_frame, live_frame in zip(stored, open_live_clip(stored), strict=True):
        counts = torch.full((1, 1, 16, 24), 2)
        stored_radiance, live_radiance = (
            pool.read(pool.empty(), counts) for pool in (stored_frame.pool, live_frame.pool)
        )
        # but where Embree's choice depends on neighbouring rays: see WavefrontTracer
        assert float((stored_radiance != live_radiance).double().mean()) < 0.01

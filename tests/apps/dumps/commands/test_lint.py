"""The commands render, import and lint: what they hand over, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.apps.render.jobs import render_clips
from rlbench.clips.stored import open_clip
from rlbench.training import dataset
from tests.cli.runner import rlbench


@pytest.fixture
def ensured(monkeypatch):
    """The calls that would render clips of presets."""
    calls = []

    def ensure(preset, scenes, seeds, executor, limit_frames):
        calls.append((preset, scenes, seeds))
        return []

    monkeypatch.setattr("rlbench.apps.render.jobs.render_clips.ensure", ensure)
    return calls


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--scenes", "cellar"), "error: no scene 'cellar'; available: bathroom, bathroom2, city"),
        (
            ("--scenes", "city-crane"),
            "error: scene 'city' has no take 'crane'; available takes: static, cut",
        ),
        (("--seeds", "48:0"), "Invalid value for '--seeds': '48:0' is no list of seeds"),
        (("--takes", "some"), "'some' is not one of 'main', 'all'"),
        (("--buffers", "taste"), "error: "),
        (("--engine", "local=auto"), "error: --engine local=auto: local has no address"),
    ],
)
def test_wrong_use_of_render_is_one_message(words, message):
    assert message in rlbench("render", *words, code=2)


def test_render_and_training_request_the_clips_of_the_seeds(ensured):
    rlbench("render", "--preset", "train", "--seeds", "0:48")
    dataset.split_generated("train", (30, 31))
    dataset.split_generated("mini", (30, 31))  # generated scenes, as large as those of mini
    assert [(preset.name, scenes, seeds) for preset, scenes, seeds in ensured] == [
        ("train", None, tuple(range(48))),
        ("train", None, (30, 31)),
        ("mini", None, (30, 31)),
    ]


def test_options_of_render_change_the_preset(ensured):
    rlbench("render", "--radiance-cap", 64, "--buffers", "object,normal_psr", "--takes", "all")
    ((preset, _, _),) = ensured
    assert preset.radiance_cap == 64
    assert {"object", "normal_psr"} <= set(preset.extra_buffers)
    assert preset.takes == "all"


@pytest.mark.parametrize(("requested", "takes"), [(None, "all"), ("main", "main")])
def test_the_takes_of_a_preset_can_be_chosen(ensured, requested, takes):
    render_clips.render_preset_clips(None, "standard", takes=requested)
    assert [(preset.name, preset.takes) for preset, _, _ in ensured] == [("standard", takes)]


def test_render_can_print_hashes_and_measure_the_time_of_a_sample(clip_folder, monkeypatch):
    monkeypatch.setattr(
        "rlbench.apps.render.jobs.render_clips.ensure", lambda *_, **__: [Path(clip_folder)]
    )
    clip = open_clip(clip_folder)
    assert rlbench("render", "--digests").strip() == f"{clip.name} {clip.digest[:12]}"
    output = rlbench("render", "--remeasure-sample-time", code=2)
    assert "was rendered on 'another machine'" in output  # by the function that measures


def test_lint_of_a_folder_without_clips_is_wrong_use(tmp_path):
    assert "error: no clip in" in rlbench("lint", tmp_path, code=2)
    assert "Invalid value for 'CLIPS" in rlbench("lint", tmp_path / "nowhere", code=2)

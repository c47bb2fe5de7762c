"""The commands render, render-scene, import and lint: what they hand over, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.parallel.executor import LOCAL
from rlbench.render.jobs import preset_clips
from rlbench.training import dataset
from tests.cli.runner import rlbench
from tests.conftest import write_noise


@pytest.fixture
def ensured(monkeypatch):
    """The calls that would render clips of presets."""
    calls = []

    def ensure(preset, scenes, seeds, executor):
        calls.append((preset, scenes, seeds))
        return []

    monkeypatch.setattr("rlbench.render.jobs.render_clips.ensure", ensure)
    return calls


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--preset", "huge"), "error: no preset 'huge'; available: tiny, mini"),
        (("--scenes", "cellar"), "error: no scene 'cellar'; available: city, generated"),
        (
            ("--scenes", "city-crane"),
            "error: scene 'city' has no take 'crane'; available takes: static, cut",
        ),
        (("--seeds", "48:0"), "Invalid value for '--seeds': '48:0' is no list of seeds"),
        (("--takes", "some"), "'some' is not one of 'main', 'all'"),
        (("--radiance-cap", "0"), "'0' is no number above 0"),
        (("--buffers", "taste"), "error: "),
        (("--camera", "orbit"), "No such option: --camera"),
        (("--ray-address", "auto"), "error: --ray-address auto applies to --engine ray only"),
    ],
)
def test_wrong_use_of_render_is_one_message(words, message):
    output = rlbench("render", *words, code=2)
    assert message in output
    assert "Traceback" not in output


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
    preset_clips.render_preset_clips(None, "standard", takes=requested)
    assert [(preset.name, preset.takes) for preset, _, _ in ensured] == [("standard", takes)]


def test_render_can_measure_the_time_of_a_sample_again(clip_folder, monkeypatch):
    monkeypatch.setattr(
        "rlbench.render.jobs.render_clips.ensure", lambda *_, **__: [Path(clip_folder)]
    )
    output = rlbench("render", "--remeasure-sample-time", code=2)
    assert "was rendered on 'another machine'" in output  # by the function that measures


@pytest.fixture
def user_clips(monkeypatch):
    """The calls that would render a user's scene with Mitsuba."""
    calls = []

    def ensure(options, preset, on_message, executor):
        calls.append((options, preset, executor))
        return Path("the clip")

    monkeypatch.setattr("rlbench.render.user.clip.ensure_user_clip", ensure)
    return calls


def test_render_scene_hands_over_its_options(user_clips, tmp_path):
    file = tmp_path / "scene.xml"
    file.touch()
    words = ("--camera", "dolly", "--frames", 5, "--size", "320x192", "--exposure", 0.5)
    words += ("-D", "max_depth=9", "-D", "light=2=3", "--out", tmp_path / "c", "--preset", "tiny")
    assert rlbench("render-scene", file, *words) == "the clip"
    ((options, preset, executor),) = user_clips
    assert (options.file, options.camera, options.frames) == (file, "dolly", 5)
    assert (options.size, options.exposure) == ((192, 320), 0.5)
    assert options.parameters == (("max_depth", "9"), ("light", "2=3"))
    assert options.out == tmp_path / "c"
    assert preset.name == "tiny"
    assert executor is LOCAL


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("none.xml", (), "Invalid value for 'FILE'"),
        ("a.max", (), "a.max: no tracer reads this format. mitsuba reads .xml, .py"),
        ("a.xml", ("--tracer", "cycles"), "error: --tracer cycles does not read a.xml"),
        ("a.xml", ("--tracer", "luxcore"), "'luxcore' is not one of 'mitsuba', 'cycles'"),
        ("a.xml", ("--size", "320"), "'320' is no size. Give WIDTHxHEIGHT"),
        ("a.xml", ("--exposure", "0"), "'0' is no number above 0"),
        ("a.xml", ("-D", "max_depth"), "'max_depth' is no NAME=VALUE"),
        ("a.xml", ("--frames", 0), "Invalid value for '--frames'"),
        ("a.xml", ("--preset", "huge"), "error: no preset 'huge'"),
        ("a.xml", ("--radiance-cap", 64), "No such option: --radiance-cap"),
        ("a.xml", ("--takes", "all"), "No such option: --takes"),
        ("a.blend", ("--engine", "ray"), "error: --engine ray cannot render with Cycles"),
    ],
)
def test_wrong_use_of_render_scene_is_one_message(user_clips, tmp_path, name, words, message):
    for existing in ("a.xml", "a.max", "a.blend"):
        (tmp_path / existing).touch()
    assert message in rlbench("render-scene", tmp_path / name, *words, code=2)
    assert user_clips == []


def test_import_of_an_unknown_format_or_folder_is_one_message(tmp_path):
    words = ("--format", "foo", "--out", tmp_path / "clips")
    output = rlbench("import", tmp_path, *words, code=2)
    assert "error: no format 'foo'; there are: oidn, noisebase, rl-path-tracing" in output
    output = rlbench("import", tmp_path / "nowhere", *words, code=2)
    assert "Invalid value for 'SOURCE'" in output


def test_lint_reports_a_faulty_clip_with_exit_code_1(tmp_path):
    write_noise(tmp_path / "clips" / "noise")  # its normals and motion belong to no scene
    output = rlbench("lint", tmp_path / "clips", "--figure", tmp_path / "lint.png", code=1)
    assert "✗" in output
    assert (tmp_path / "lint.png").stat().st_size > 0


def test_lint_of_a_folder_without_clips_is_wrong_use(tmp_path):
    assert "error: no clip in" in rlbench("lint", tmp_path, code=2)
    assert "Invalid value for 'CLIPS" in rlbench("lint", tmp_path / "nowhere", code=2)

"""The command render with a scene file: what it hands over, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.parallel.executor import LOCAL
from tests.cli.runner import rlbench


@pytest.fixture
def user_clips(monkeypatch):
    """The calls that would render a user's scene with Mitsuba."""
    calls = []

    def ensure(options, preset, on_message, executor):
        calls.append((options, preset, executor))
        return Path("the clip")

    monkeypatch.setattr("rlbench.apps.render.user.clip.ensure_user_clip", ensure)
    return calls


def test_render_hands_over_its_options(user_clips, tmp_path):
    file = tmp_path / "scene.xml"
    file.touch()
    words = ("--camera", "dolly", "--frames", 5, "--size", "320x192", "--exposure", 0.5)
    words += ("-D", "max_depth=9", "-D", "light=2=3", "--out", tmp_path / "c", "--preset", "tiny")
    assert rlbench("render", file, *words) == "the clip"
    ((options, preset, executor),) = user_clips
    assert (options.file, options.camera, options.frames) == (file, "dolly", 5)
    assert (options.size, options.exposure) == ((192, 320), 0.5)
    assert options.parameters == (("max_depth", "9"), ("light", "2=3"))
    assert options.out == tmp_path / "c"
    assert (preset.name, preset.size) == ("tiny-320x192", (192, 320))
    assert executor is LOCAL


@pytest.mark.parametrize(
    ("name", "main", "skies"),
    [("dining-room", "scene.xml", ("", "sun")), ("shanghai", "scene.gltf", ("1", "sun"))],
)
def test_a_scene_by_others_is_rendered_as_a_file(
    user_clips, tmp_path, monkeypatch, name, main, skies
):
    monkeypatch.setenv("RLBENCH_SCENES", str(tmp_path))
    monkeypatch.chdir(tmp_path / "..")
    file = tmp_path / name / main
    file.parent.mkdir()
    file.touch()
    rlbench("render", name, "-D", "width=45", "--camera", "wander")
    rlbench("render", name, "--sky", "sun")
    assert [options.file for options, *_ in user_clips] == [file, file]
    assert tuple(options.sky for options, *_ in user_clips) == skies
    assert user_clips[0][0].parameters == (("width", "45"),)


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("none.xml", (), "Invalid value for 'FILE'"),
        ("a.max", (), "a.max: no tracer reads it. mitsuba reads .xml, .py"),
        ("a.pbrt", (), "a.pbrt: neither Mitsuba nor Cycles reads pbrt. Convert it"),
        ("a.blend", ("--skip-missing",), "--skip-missing is for Mitsuba XML files"),
        ("a.xml", ("--tracer", "cycles"), "error: --tracer cycles does not read a.xml"),
        ("a.xml", ("--tracer", "luxcore"), "'luxcore' is not one of 'mitsuba', 'cycles'"),
        ("a.xml", ("--size", "320"), "'320' is not a size. Give WIDTHxHEIGHT"),
        ("a.xml", ("--exposure", "0"), "'0' is not a number above 0"),
        ("a.xml", ("-D", "max_depth"), "'max_depth' is no NAME=VALUE"),
        ("a.xml", ("--frames", 0), "Invalid value for '--frames'"),
        ("a.xml", ("--preset", "huge"), "error: no preset 'huge'"),
        ("a.xml", ("--radiance-cap", 64), "--radiance-cap is for presets"),
        ("a.xml", ("--takes", "all"), "--takes is for presets"),
        (".", (), "Invalid value for 'FILE'"),
        ("a.blend", ("--engine", "ray"), "error: --engine ray cannot render with Cycles"),
    ],
)
def test_wrong_use_with_a_scene_file_is_one_message(user_clips, tmp_path, name, words, message):
    for existing in ("a.xml", "a.max", "a.blend", "a.pbrt"):
        (tmp_path / existing).touch()
    assert message in rlbench("render", tmp_path / name, *words, code=2)
    assert user_clips == []


def test_options_of_a_scene_file_need_one():
    assert "--camera is for a scene FILE" in rlbench("render", "--camera", "still", code=2)

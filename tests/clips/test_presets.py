"""Presets."""

from pathlib import Path

import pytest

from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import preset_jobs
from rlbench.clips.presets import PRESETS, get_preset, is_test_split
from tests.apps.render.small_scenes import room


def content_key(preset):
    return Job("room", room(), preset, Path("a")).content_key


def test_the_papers_protocol():
    paper = PRESETS["paper"]
    assert (paper.size, paper.frames, paper.pool_spp) == ((720, 720), 20, 8)
    assert 2 * paper.reference_spp == 1000
    assert paper.paths_per_frame == 720 * 720 * 1008


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (PRESETS["mini"].with_radiance_cap(64.0), "mini-cap64"),
        (PRESETS["mini"].with_buffers(["object"]), "mini-views"),
    ],
)
def test_a_changed_preset_has_another_name_and_content_key(changed, name):
    assert changed.name == name
    assert content_key(changed) != content_key(PRESETS["mini"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: PRESETS["mini"].with_radiance_cap(0.0), "must be above 0"),
        (lambda: PRESETS["mini"].with_radiance_cap(float("nan")), "must be above 0"),
        (
            lambda: PRESETS["mini"].with_buffers(["object", "emission"]),
            "no G-buffer channel emission to add; available: object",
        ),
        (lambda: get_preset("huge"), "mini"),
    ],
)
def test_what_presets_do_not_have_is_an_error(change, message):
    with pytest.raises((ValueError, LookupError), match=message):
        change()


def test_a_preset_at_another_size_has_another_name_folder_and_content_key(monkeypatch, tmp_path):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path))
    mini, large = PRESETS["mini"], get_preset("mini", (360, 640))
    assert (large.name, large.size) == ("mini-640x360", (360, 640))
    assert get_preset("mini-640x360") == large
    assert get_preset("mini-640x360", (192, 192)) == mini == get_preset("mini", (192, 192))
    assert content_key(large) != content_key(mini)
    (job,) = preset_jobs(large, ["city"])
    assert job.folder == tmp_path / "clips" / "mini-640x360" / "city"
    own = PRESETS["development-640x360"]  # of which there are clips
    assert get_preset("development", (360, 640)) is own


@pytest.mark.parametrize(
    ("name", "is_test"),
    [("unseen-640x360", True), ("train-320x320", False), ("train-windows", False)],
)
def test_a_preset_at_another_size_has_the_use_of_its_own(name, is_test):
    assert is_test_split(name) == is_test
    assert get_preset(name).is_test_set == is_test


def test_speeds_are_dealt_to_clips_by_their_seed():
    preset = PRESETS["development-640x360"]
    speeds = [preset.speed(f"generated-{seed:03d}") for seed in (42, 43, 44, 45)]
    assert speeds == [*preset.speeds, preset.speeds[0]]
    assert preset.speed("city") == 1

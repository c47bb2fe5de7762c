"""The option --limit-frames: a trial renders the first frames alone, and what they score stays."""

from __future__ import annotations

from pathlib import Path

import pytest

import rlbench.benchmark.results as table
from rlbench.clips.header import read_header
from rlbench.clips.stored import open_clip
from rlbench.system import paths
from tests.cli.runner import rlbench

SCENE = ("--preset", "tiny", "--scenes", "temple", "--size", "32x24")
RUN = ("run", "-m", "mean", "--spp", 1, "--times", "none", "--keep-images", *SCENE)


def rows(folder):
    found = table.read(folder).drop(columns="run_id")  # of times of this machine too
    return found.sort_values(["metric", "frame"]).reset_index(drop=True)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache in which a trial was run, then the whole clip, then its first frames."""
    cache = tmp_path_factory.mktemp("limit")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(cache / "cache"))
        trial = rlbench(*RUN, "--limit-frames", 2, "--out", cache / "trial")
        assert "2 frames of 1 clip of" in trial
        clip = paths.clips_folder() / "tiny-32x24" / "temple"
        views = sorted(file.name for file in clip.glob("view.*"))
        assert views == ["view.0000.exr", "view.0001.exr"]
        rlbench("evaluate", cache / "trial", "--preset", "tiny-32x24", "--scenes", "temple")
        rlbench("view", cache / "trial", "--out", cache / "page.html")
        assert read_header(clip).frames == 2  # looking at a trial renders nothing
        live = ("run", "-m", "mean", "--spp", 1, "--times", "none", "--pool", "live", *SCENE)
        rlbench(*live, "--limit-frames", 1, "--out", cache / "live")
        rlbench(*RUN, "--out", cache / "whole")
        assert read_header(clip).frames == 4
        rlbench(*RUN, "--limit-frames", 2, "--out", cache / "cut")
        assert "nothing to do" in rlbench(*RUN, "--limit-frames", 2, "--out", cache / "trial")
        yield cache


def test_a_trial_has_the_rows_of_the_whole_clip_cut_to_its_frames(cache):
    trial, cut, every, live = (rows(cache / name) for name in ("trial", "cut", "whole", "live"))
    assert trial.equals(cut)
    values = trial.query("frame >= 0").set_index(["metric", "frame"])["value"]
    assert {0, 1} <= set(values.index.get_level_values("frame"))
    assert values.equals(every.query("frame in [0, 1]").set_index(["metric", "frame"])["value"])
    first = live.query("metric == 'psnr' and frame == 0")["value"].item()
    assert first == values["psnr", 0]


def test_images_of_a_trial_are_shown_and_scored_again(cache):
    assert (cache / "page.html").stat().st_size
    psnr, again = (
        rows(folder).query("metric == 'psnr'")["value"].to_list()
        for folder in (cache / "trial", cache / "trial" / "evaluated")
    )
    assert again == pytest.approx(psnr, abs=0.01)  # images are kept in half floats


def test_a_scene_file_renders_first_frames_then_the_others(tmp_path):
    scene = tmp_path / "scene.py"
    guide = (Path(__file__).parents[2] / "docs" / "how-to" / "add-a-scene.md").read_text()
    scene.write_text(guide.partition("```python\n")[2].partition("```")[0])
    words = ("render", scene, "--size", "24x16", "--frames", 4, "--camera", "orbit")
    part, whole = tmp_path / "part", tmp_path / "whole"
    rlbench(*words, "--limit-frames", 2, "--out", part)
    rlbench(*words, "--out", whole)
    assert open_clip(part).digest == open_clip(whole, limit_frames=2).digest
    assert read_header(part).exposure == read_header(whole).exposure
    rlbench(*words, "--out", part)
    assert open_clip(part).digest == open_clip(whole).digest

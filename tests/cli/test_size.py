"""The option --size: clips, rows and files of options that know it."""

from __future__ import annotations

import rlbench.benchmark.results as table
from tests.cli.runner import rlbench


def test_a_run_at_a_size_renders_it_and_its_file_of_options_repeats_it(tmp_path):
    words = ("run", "--out", tmp_path / "r")
    rlbench(
        *(*words, "-m", "mean", "--preset", "tiny", "--scenes", "temple", "--size", "32x24"),
        *("--spp", 1, "--times", "none"),
    )
    rows = table.read(tmp_path / "r")
    assert set(rows["size"]) == {"32x24"}
    assert set(rows["preset"]) == {"tiny-32x24"}
    config = tmp_path / "r" / "run.toml"
    assert 'size = "32x24"' in config.read_text()
    assert "nothing to do: all 1 cells" in rlbench(*words, "--config", config)
    printed = rlbench("render", "--preset", "tiny-32x24", "--scenes", "temple", "--motion")
    assert "tiny-32x24/temple motion in pixels a frame: median" in printed
    other = (*words, "--config", config, "--size", "24x24")
    assert "exist for preset tiny-32x24 and would be overwritten" in rlbench(*other, code=2)


def test_a_size_of_clips_in_folders_is_refused(clip_folder, tmp_path):
    words = ("run", "-m", "mean", "--clips", clip_folder, "--size", "32x24", "--out", tmp_path)
    assert "--size applies to preset scenes only" in rlbench(*words, code=2)

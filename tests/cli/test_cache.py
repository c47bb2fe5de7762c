"""The command cache: it lists, it prunes what was selected, and it leaves unknown files alone."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_noise

DAY = 86_400


@pytest.fixture
def cache(tmp_path) -> Path:
    """A cache with clips of two presets, decoded frames, a kernel, times, and unknown files."""
    folder = tmp_path / "cache"
    write_noise(folder / "clips" / "mini" / "city")
    write_noise(folder / "clips" / "unseen" / "generated-400")
    (folder / "clips" / "mini" / "city" / "notes.md").write_text("mine")
    files = (f"decoded/{'0' * 32}-{'1' * 8}/view/depth.0000.npy", "drjit-llvm19-0/a.bin")
    for name in (*files, "sample_ms.json", "thesis.pdf", "decoded/stray/a.npy"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("content")
    return folder


def files(folder: Path) -> set[str]:
    return {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


def make_old(folder: Path, days: float) -> None:
    then = time.time() - days * DAY
    for file in folder.rglob("*"):
        os.utime(file, (then, then))


def test_the_cache_is_listed_by_kind_with_what_makes_it_again(cache):
    found = json.loads(rlbench("cache", "--json"))
    kinds = [entry["kind"] for entry in found["entries"]]
    assert kinds == ["clips", "clips", "decoded frames", "kernels", "sample times"]
    assert found["entries"][0]["bytes"] > 1000
    assert len(found["unknown"]) == 3
    assert str(cache / "thesis.pdf") in found["unknown"]
    output = rlbench("cache")
    assert "clips of mini" in output
    assert "3 files that rlbench does not know, which stay" in output


def test_prune_removes_decoded_frames_alone(cache):
    before = files(cache)
    assert "removed from" in rlbench("cache", "prune")
    assert {file.split("/")[0] for file in before - files(cache)} == {"decoded"}
    assert "decoded/stray/a.npy" in files(cache)


def test_prune_of_a_preset_keeps_other_clips_and_unknown_files(cache):
    rlbench("cache", "prune", "--preset", "mini")
    assert not list(cache.glob("clips/mini/**/*.exr"))
    assert (cache / "clips" / "mini" / "city" / "notes.md").read_text() == "mine"
    assert (cache / "clips" / "unseen" / "generated-400" / "clip.toml").exists()


def test_prune_by_age_removes_what_was_not_used_since(cache):
    make_old(cache, 40)
    (cache / "sample_ms.json").write_text("{}")
    rlbench("cache", "prune", "--older-than", "30d")
    left = {"sample_ms.json", "thesis.pdf", "decoded/stray/a.npy", "clips/mini/city/notes.md"}
    assert files(cache) == left
    assert not (cache / "clips" / "unseen").exists()


def test_a_dry_run_removes_nothing(cache):
    before = files(cache)
    assert "clips generated-400" in rlbench("cache", "prune", "--preset", "unseen", "--dry-run")
    assert files(cache) == before


def test_an_empty_cache_is_no_error():
    assert json.loads(rlbench("cache", "--json"))["entries"] == []
    assert "0 entries" in rlbench("cache", "prune")

"""The command view, on a small clip."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.clips.exr import write_exr
from tests.cli.runner import rlbench


@pytest.fixture
def run(clip_folder, tmp_path):
    """Runs mean at 1 and 2 spp on the small clip, with further words; returns the results."""

    def run_with(*words):
        out = tmp_path / "r"
        rlbench("run", "-m", "mean", "--clips", clip_folder, "--spp", "1,2", "--out", out, *words)
        return out

    return run_with


def test_view_writes_a_page_with_the_images_of_the_budget_nearest_to_1_spp(run, clip_folder):
    results = run("--keep-images")
    assert rlbench("view", results, "--clips", clip_folder) == f"{results}/report.html"
    page = (results / "report.html").read_text()
    assert '"method":"mean","spp":1.0,"frames":[{"shape":[3,20,24]' in page
    assert '"spp":2.0,"frames"' not in page


def test_view_shows_the_budgets_that_are_named(run, clip_folder, tmp_path):
    words = ("--clips", clip_folder, "--spp", "2", "--out", tmp_path / "page.html")
    rlbench("view", run("--keep-images"), *words)
    assert '"spp":2.0,"frames"' in (tmp_path / "page.html").read_text()


def test_view_says_how_to_get_images(run):
    output = rlbench("view", run())
    assert "the page has decision and table alone: the results keep no images" in output
    assert "--keep-images" in output


def test_view_asks_for_the_folder_of_clips_without_a_preset(run):
    assert "name the folder with --clips" in rlbench("view", run("--keep-images"))


def test_view_of_a_size_that_is_too_small_says_what_to_do(run, clip_folder):
    words = ("view", run("--keep-images"), "--clips", clip_folder, "--max-mb", 0.05)
    assert "allow a larger page with --max-mb" in rlbench(*words, code=2)


def test_view_of_budgets_without_images_says_which_there_are(run, clip_folder):
    words = ("view", run("--keep-images"), "--clips", clip_folder, "--spp", 8)
    assert "no images at 8 spp; the results keep 1, 2" in rlbench(*words, code=2)


def test_view_needs_results(tmp_path):
    assert "no results in" in rlbench("view", tmp_path, code=2)


@pytest.fixture
def image_files(tmp_path):
    """Two EXR files of one size."""
    files = [tmp_path / "a.exr", tmp_path / "b.exr"]
    for value, file in enumerate(files):
        write_exr(file, dict.fromkeys("RGB", np.full((20, 24), value / 2, np.float32)))
    return files


def test_view_of_image_files_writes_a_page_of_them(image_files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert rlbench("view", "a.exr", "b.exr", "-q").endswith("gallery.html")
    page = (tmp_path / "gallery.html").read_text()
    assert page.count('"frames":[{"shape":[3,20,24]') == 2
    rlbench("view", image_files[0], "--out", tmp_path / "one.html")
    assert (tmp_path / "one.html").read_text().count('"frames":[{"shape"') == 1


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["a.exr", "folder"], "folder is a folder, and 2 paths are given"),
        (["folder", "a.exr"], "folder is a folder, and 2 paths are given"),
        (["a.exr", "missing.exr"], "missing.exr"),
        (["a.exr", "b.exr", "--spp", "1"], "--spp is for results"),
        (["a.exr", "--max-mb", "0.05"], "larger page with --max-mb"),
        (["folder", "--layer", "V"], "--layer V is for image files"),
    ],
)
def test_view_of_what_it_cannot_show_together_says_what_it_shows(
    image_files, tmp_path, monkeypatch, words, found
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    assert found in rlbench("view", *words, code=2)
    assert not (tmp_path / "gallery.html").exists()

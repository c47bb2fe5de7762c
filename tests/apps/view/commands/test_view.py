"""The command view, on a small clip."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.clips.exr import write_exr
from tests.cli.runner import rlbench


def test_view_writes_a_page_with_the_images_of_the_budget_nearest_to_1_spp(
    image_results, image_run
):
    assert (
        rlbench("view", image_results, "--clips", image_run / "clips")
        == f"{image_results}/report.html"
    )
    page = (image_results / "report.html").read_text()
    assert '"method":"mean","spp":1.0,"frames":[{"shape":[3,20,24]' in page
    assert '"spp":2.0,"frames"' not in page


def test_view_shows_the_budgets_that_are_named(image_results, image_run, tmp_path):
    words = ("--clips", image_run / "clips", "--spp", "2", "--out", tmp_path / "page.html")
    rlbench("view", image_results, *words)
    assert '"spp":2.0,"frames"' in (tmp_path / "page.html").read_text()


def test_view_says_how_to_get_images(plain_results):
    output = rlbench("view", plain_results)
    assert "the page has decision and table alone: the results keep no images" in output
    assert "--keep-images" in output


def test_view_says_what_to_change(image_results, image_run, tmp_path):
    assert "name the folder with --clips" in rlbench("view", image_results)
    words = ("view", image_results, "--clips", image_run / "clips")
    assert "allow a larger page with --max-mb" in rlbench(*words, "--max-mb", 0.05, code=2)
    assert "no images at 8 spp; the results keep 1, 2" in rlbench(*words, "--spp", 8, code=2)
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

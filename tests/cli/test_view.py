"""The command view, on a small clip."""

from __future__ import annotations

from tests.cli.runner import rlbench


def test_view_writes_a_page_with_the_images_of_the_budget_nearest_to_1_spp(kept, kept_run):
    assert rlbench("view", kept, "--clips", kept_run / "clips") == f"{kept}/report.html"
    page = (kept / "report.html").read_text()
    assert '"method":"mean","spp":1.0,"frames":[{"shape":[3,20,24]' in page
    assert '"spp":2.0,"frames"' not in page


def test_view_shows_the_budgets_that_are_named(kept, kept_run, tmp_path):
    words = ("--clips", kept_run / "clips", "--spp", "2", "--out", tmp_path / "page.html")
    rlbench("view", kept, *words)
    assert '"spp":2.0,"frames"' in (tmp_path / "page.html").read_text()


def test_view_says_how_to_get_images(bare):
    output = rlbench("view", bare)
    assert "the page has decision and table alone: the results keep no images" in output
    assert "--keep-images" in output


def test_view_says_what_to_change(kept, kept_run, tmp_path):
    assert "name the folder with --clips" in rlbench("view", kept)
    words = ("view", kept, "--clips", kept_run / "clips")
    assert "allow a larger page with --max-mb" in rlbench(*words, "--max-mb", 0.05, code=2)
    assert "no images at 8 spp; the results keep 1, 2" in rlbench(*words, "--spp", 8, code=2)
    assert "no results in" in rlbench("view", tmp_path, code=2)

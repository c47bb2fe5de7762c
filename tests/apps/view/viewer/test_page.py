"""The page as a file: one, whole, deterministic, without the network."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from rlbench.apps.view.viewer import write
from rlbench.apps.view.viewer.page import ASSETS
from rlbench.apps.view.viewer.pictures import MAX_METHODS

LONGEST_MODULE = 300  # lines, as of Python's


def data_of(file):
    return json.loads(re.search(r'id="data">(.*?)</script>', file.read_text(), re.DOTALL)[1])


def psnr_of(report):
    """The rows of a page without other scores."""
    return report.rows[report.rows["metric"].isin(["psnr", "inference_ms"])]


@pytest.fixture
def few(results):
    """Results of one score, which are quick to write."""
    return results[results["metric"] != "relmse"]


def test_equal_results_give_equal_bytes(few, tmp_path):
    files = [tmp_path / name for name in ("a.html", "b.html")]
    for file in files:
        write(few, file)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_results_without_images_give_decision_and_table(few, tmp_path):
    write(few, tmp_path / "r.html", remarks=["no images"])
    data = data_of(tmp_path / "r.html")
    assert data["remarks"] == ["no images"]
    assert data["devices"][0]["decide"][0]["metric"] == "psnr"
    assert 'class="clip">' not in (tmp_path / "r.html").read_text()


def test_text_of_the_results_cannot_end_its_element(few, tmp_path):
    hostile = few.assign(config='{"x": "</script><b>"}')
    write(hostile, tmp_path / "r.html")
    assert "</script><b>" not in (tmp_path / "r.html").read_text()
    assert "</script><b>" in data_of(tmp_path / "r.html")["provenance"]["ours"]["config"]


def test_the_page_names_nothing_that_a_browser_would_fetch(report):
    page = report.file.read_text()
    assert not re.findall(r"""(?:src|href)=["'](?!data:)|@import|url\((?!["']?[#d])""", page)


def test_the_page_stays_below_its_size(report, tmp_path):
    large, small = tmp_path / "large.html", tmp_path / "small.html"
    write(psnr_of(report), large, report.clips)
    size = int(0.8 * large.stat().st_size)
    write(psnr_of(report), small, report.clips, max_bytes=size)
    assert small.stat().st_size <= size
    assert data_of(small)["relative_error"] > data_of(large)["relative_error"]


def test_more_methods_than_keys_are_left_out_and_named(report, tmp_path):
    clip = report.clips[0]
    first = clip.images[0]
    more = tuple(replace(first, method=f"m{index}") for index in range(MAX_METHODS + 1))
    remarks = write(psnr_of(report), tmp_path / "r.html", [replace(clip, images=more)])
    assert remarks[0].startswith("images of m9 are not in the page")


def test_modules_of_the_page_are_short_enough_to_read():
    assert all(len(file.read_text().splitlines()) <= LONGEST_MODULE for file in ASSETS.iterdir())

"""The report by clip: means of formulas, the order of methods, and differences to ours."""

from __future__ import annotations

import pytest

from reports import per_clip
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import SCENES, psnr, rows

FRAMES = range(4)


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return per_clip.write(results, tmp_path_factory.mktemp("clips"), draws=200)[0].read_text()


def parse_table(page, spp):
    """Header, and cells by first column and header."""
    section = page[page.index(f"### PSNR [dB] at {spp} spp") :].split("###")[1]
    lines = [line.split("|")[1:-1] for line in section.splitlines() if line.startswith("|")]
    header, _, *body = [[cell.strip() for cell in line] for line in lines]
    return header, {line[0]: dict(zip(header[1:], line[1:], strict=True)) for line in body}


def test_every_clip_has_a_row_with_its_mean_over_frames(page):
    _, body = parse_table(page, 4)
    expected = sum(psnr("ntas", "hall", 4, clip=1, frame=f) for f in FRAMES) / len(FRAMES)
    assert body["hall-1"]["ntas"] == f"{expected:.2f}"
    assert len(body) == 2 * len(SCENES) + 2


def test_methods_are_ordered_by_their_means_and_the_best_of_a_clip_is_bold(page):
    header, body = parse_table(page, 1)
    assert header[1:] == ["ours", "ours/latent-small", "ntas", "oidn", "mean"]
    assert body["city-0"]["ours"].startswith("**")
    assert not body["city-0"]["ntas"].startswith("**")


def test_the_last_row_is_the_difference_to_ours(page):
    _, body = parse_table(page, 1)
    assert body["minus ours"]["ours"] == "-"
    assert body["minus ours"]["ntas"].strip("*").startswith("-1.30 [-1.3")


def test_without_ours_methods_are_compared_with_the_best(tmp_path):
    table = to_dataframe(rows(("mean", "oidn", "ntas")))
    header, body = parse_table(per_clip.write(table, tmp_path, draws=10)[0].read_text(), 2)
    assert header[1] == "ntas"
    assert body["minus ntas"]["ntas"] == "-"


def test_a_method_that_lacks_a_scene_has_no_mean_and_comes_last(tmp_path):
    incomplete = [r for r in rows(("oidn", "ntas")) if (r.method, r.scene) != ("ntas", "hall")]
    header, body = parse_table(
        per_clip.write(to_dataframe(incomplete), tmp_path, draws=10)[0].read_text(), 2
    )
    assert header[1:] == ["oidn", "ntas"]
    for line in ("hall-0", "mean over scenes", "minus oidn"):
        assert body[line]["ntas"] == "-"

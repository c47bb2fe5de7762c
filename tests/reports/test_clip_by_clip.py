"""The page of clips: means of formulas, the order of rows, and differences held against ours."""

from __future__ import annotations

import pytest
from conftest import SCENES, psnr, rows

from reports import per_clip
from rlbench.benchmark.results import to_dataframe

FRAMES = range(4)


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return per_clip.write(results, tmp_path_factory.mktemp("clips"), draws=200)[0].read_text()


def grid(page, spp):
    section = page[page.index(f"### PSNR [dB] at {spp} spp") :].split("###")[1]
    lines = [line.split("|")[1:-1] for line in section.splitlines() if line.startswith("|")]
    head, _, *body = [[cell.strip() for cell in line] for line in lines]
    return head, {line[0]: dict(zip(head[1:], line[1:], strict=True)) for line in body}


def test_every_clip_has_a_line_with_its_mean_over_frames(page):
    _, body = grid(page, 4)
    wanted = sum(psnr("ntas", "hall", 4, clip=1, frame=f) for f in FRAMES) / len(FRAMES)
    assert body["hall-1"]["ntas"] == f"{wanted:.2f}"
    assert len(body) == 2 * len(SCENES) + 2


def test_methods_stand_in_the_order_of_their_means_and_the_best_of_a_clip_is_bold(page):
    head, body = grid(page, 1)
    assert head[1:] == ["ours", "ours/small", "ntas", "oidn", "mean"]
    assert body["city-0"]["ours"].startswith("**")
    assert not body["city-0"]["ntas"].startswith("**")


def test_the_last_line_is_the_difference_to_ours(page):
    _, body = grid(page, 1)
    assert body["less ours"]["ours"] == "-"
    assert body["less ours"]["ntas"].strip("*").startswith("-1.30 [-1.3")


def test_without_ours_rows_are_held_against_the_best(tmp_path):
    table = to_dataframe(rows(("mean", "oidn", "ntas")))
    head, body = grid(per_clip.write(table, tmp_path, draws=10)[0].read_text(), 2)
    assert head[1] == "ntas"
    assert body["less ntas"]["ntas"] == "-"


def test_what_lacks_a_scene_has_dashes_there_and_no_mean_and_comes_last(tmp_path):
    made = [r for r in rows(("oidn", "ntas")) if (r.method, r.scene) != ("ntas", "hall")]
    head, body = grid(per_clip.write(to_dataframe(made), tmp_path, draws=10)[0].read_text(), 2)
    assert head[1:] == ["oidn", "ntas"]
    for line in ("hall-0", "mean over scenes", "less oidn"):
        assert body[line]["ntas"] == "-"

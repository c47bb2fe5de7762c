"""Commands that draw what `rlbench speed` and `rlbench stress` recorded."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.image import imread

from reports import memory, stress_matrix
from reports.published import published
from reports.stress_matrix import FILLS, INK, MARKS, Cell
from rlbench.checks.stress.run import VERDICT_NAMES
from tests.reports.conftest import cells

DOCS = Path(__file__).parents[2] / "docs"
RESULTS = DOCS / "results"


def has_ink(file):
    image = imread(file)[..., :3]
    return image.min() < 0.25 < image.max()


SPEED = pd.DataFrame(
    [
        ("ours/latent", 720, 720, 1000.0, 190.0, 200.0, 1000.0),
        ("ours/latent@openvino", 720, 720, 1000.0, 190.0, 200.0, float("nan")),
        ("ours/latent", 64, 64, 1000.0, 190.0, 201.0, 10.0),
        ("svgf", 720, 720, 0.0, 0.0, 45.0, float("nan")),
    ],
    columns=[
        "method", "height", "width", "parameters", "multiply_adds", "state_bytes", "memory_mb",
    ],
)  # fmt: skip


def test_memory_is_counted_as_the_paper_counts():
    page = memory.memory_page(SPEED)
    assert page.startswith("# Memory and work of a frame: 720 x 720\n")
    # 200 x 720² / 2²⁰
    assert cells(page, "By", "`ours/latent`") == ["1000", "190.0", "200", "98.9", "1000"]
    assert cells(page, "By", "`svgf`")[-1] == "-"
    assert cells(page, "Beside", "state, bytes") == ["128", "200"]
    assert cells(page, "Beside", "state, 24") == ["212", "284"]  # 200 + 4 x (24 + 7 - 10)
    assert cells(page, "Beside", "the same") == ["110", "147"]  # 284 x 720² / 10⁶
    assert cells(page, "Beside", "weights") == ["< 50", "4.0"]
    small = memory.memory_page(SPEED[SPEED["width"] == 64])
    assert "64 x 64" in small.splitlines()[0]
    assert "Beside the paper" not in memory.memory_page(SPEED[SPEED["method"] == "svgf"])


def test_the_published_account_of_memory_adds_up():
    paper = published().memory
    added = paper.state_channels + paper.sample_channels + paper.guide_channels
    assert 4 * (added - paper.earlier_channels) == paper.bytes_per_pixel
    assert paper.bytes_per_pixel * paper.size**2 / 1e6 == pytest.approx(paper.megabytes, abs=0.5)


STRESS = [  # method, section, test, verdict, figure, unit, good, fair, found, remedy
    ["method", "section", "test", "verdict", "figure", "unit", "good", "fair", "found", "remedy"],
    ("mean", "bad-pixel", "sample-nan", "passed", "1", "pixels", "256", "", "", ""),
    ("mean", "bad-pixel", "depth-nan", "skipped", "", "", "", "", "reads no depth", ""),
    ("mean", "budgets", "spp-0", "passed", "0", "pixels", "0", "0", "", ""),
    ("ours/A1", "bad-pixel", "sample-nan", "failed", "inf", "pixels", "256", "", "spreads", "clip"),
    ("ours/A1", "bad-pixel", "depth-nan", "degraded", "300", "pixels", "256", "", "far", "a|b"),
    ("ntas", "bad-pixel", "sample-nan", "failed", "300", "pixels", "256", "", "spreads", "clip"),
    ("ours/A1", "budgets", "run", "skipped", "", "", "", "", "no weights", ""),
    ("", "metrics", "psnr-nan", "passed", "0", "dB", "", "", "", ""),
]


@pytest.fixture
def matrix(tmp_path):
    with (tmp_path / "stress.csv").open("w", newline="") as file:
        csv.writer(file).writerows(STRESS)
    return stress_matrix.read_results(tmp_path)


def test_a_cell_holds_the_worst_verdict_and_the_passed_tests_of_those_that_ran(matrix):
    assert matrix.summary("mean", "bad-pixel") == Cell("passed", "1/1")
    assert matrix.summary("ours/A1", "bad-pixel") == Cell("failed", "0/2")
    assert matrix.summary("ours/A1", "budgets") == Cell("skipped")
    assert matrix.summary("mean", "metrics") is None
    assert matrix.sections(is_suite=True) == ["metrics"]


def test_the_stress_page_lists_what_did_not_pass_with_the_worst_first(matrix, tmp_path):
    files = stress_matrix.write_page(matrix, tmp_path / "made")
    names = ["stress.md", "stress.png", "stress-bad-pixel.png", "stress-budgets.png"]
    assert [file.name for file in files] == names
    assert all(has_ink(file) for file in files[1:])
    page = files[0].read_text()
    assert "Planted bad pixels: 1 of 4 contained.\n" in page
    assert "| mean | ✓ 1/1 | ✓ 1/1 |\n| ours/A1 | ✗ 0/2 | – |\n" in page  # noqa: RUF001
    failed = "| sample-nan | ✗ | ours/A1, ntas | 300 to inf pixels (256) | clip |"
    degraded = "| depth-nan | ! | ours/A1 | 300 pixels (256) | a\\|b |"
    assert f"{failed}\n{degraded}\n" in page
    assert page.endswith("## metrics\n\nEvery test passed.\n")


def brightness(color):
    r, g, b = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return 0.299 * r + 0.587 * g + 0.114 * b


def test_verdicts_differ_in_grey_and_the_mark_stands_out():
    assert set(MARKS) == set(FILLS) == set(INK) == set(VERDICT_NAMES.values())
    levels = sorted(brightness(FILLS[name]) for name in ("passed", "degraded", "failed"))
    assert min(b - a for a, b in zip(levels, levels[1:], strict=False)) > 0.1
    assert all(abs(brightness(FILLS[n]) - brightness(INK[n])) > 0.45 for n in FILLS)

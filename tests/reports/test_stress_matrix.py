"""The stress matrix: worst verdicts, counts, pictures, and the table of the README."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from reports import stress_matrix
from reports.stress_matrix import FILLS, INK, MARKS, Cell, draw_grid
from rlbench.checks.stress.run import VERDICT_NAMES

ROWS = [  # method, section, test, verdict, figure, unit, good, fair, found, remedy
    ("mean", "bad-pixel", "sample-nan", "passed", "1", "pixels", "256", "", "", ""),
    ("mean", "bad-pixel", "depth-nan", "skipped", "", "", "", "", "reads no depth", ""),
    ("mean", "budgets", "spp-0", "passed", "0", "pixels", "0", "0", "", ""),
    ("ours/A1", "bad-pixel", "sample-nan", "failed", "inf", "pixels", "256", "", "spreads", "clip"),
    ("ours/A1", "bad-pixel", "depth-nan", "degraded", "300", "pixels", "256", "", "a|b", "clamp"),
    ("ours/A1", "budgets", "run", "skipped", "", "", "", "", "no weights", ""),
    ("", "metrics", "psnr-nan", "passed", "0", "dB", "", "", "", ""),
]


@pytest.fixture
def results(tmp_path: Path) -> Path:
    names = (
        *("method", "section", "test", "verdict", "figure"),
        *("unit", "good", "fair", "found", "remedy"),
    )
    with (tmp_path / "stress.csv").open("w", newline="") as file:
        csv.writer(file).writerows([names, *ROWS])
    return tmp_path


def test_a_cell_holds_the_worst_verdict_and_the_passed_tests_of_those_that_ran(results):
    matrix = stress_matrix.read_results(results)
    assert matrix.summary("mean", "bad-pixel") == Cell("passed", "1/1")
    assert matrix.summary("ours/A1", "bad-pixel") == Cell("failed", "0/2")
    assert matrix.summary("ours/A1", "budgets") == Cell("skipped")
    assert matrix.summary("mean", "metrics") is None


def test_sections_of_the_suite_are_apart_from_those_of_methods(results):
    matrix = stress_matrix.read_results(results)
    assert matrix.methods == ["mean", "ours/A1"]
    assert matrix.sections() == ["bad-pixel", "budgets"]
    assert matrix.sections(is_suite=True) == ["metrics"]


def test_the_page_lists_what_did_not_pass_with_the_worst_first(results, tmp_path):
    files = stress_matrix.write_page(stress_matrix.read_results(results), tmp_path / "made")
    assert all(file.stat().st_size for file in files)
    page = files[0].read_text()
    assert "Planted bad pixels: 1 of 3 contained.\n" in page
    assert "| mean | ✓ 1/1 | ✓ 1/1 |\n| ours/A1 | ✗ 0/2 | – |\n" in page  # noqa: RUF001
    failed = "| ours/A1 | sample-nan | ✗ | inf pixels (256) | spreads | clip |"
    degraded = "| ours/A1 | depth-nan | ! | 300 pixels (256) | a\\|b | clamp |"
    assert f"{failed}\n{degraded}\n" in page
    assert page.endswith("## metrics\n\nEvery test passed.\n")
    assert {file.name for file in files} == {
        *("stress.md", "stress.png", "stress-bad-pixel.png", "stress-budgets.png")
    }


def test_equal_results_give_equal_files(results, tmp_path):
    matrix = stress_matrix.read_results(results)
    first, second = (stress_matrix.write_page(matrix, tmp_path / name) for name in "ab")
    assert [file.read_bytes() for file in first] == [file.read_bytes() for file in second]


def test_every_verdict_has_a_mark_and_colours(tmp_path):
    assert set(MARKS) == set(FILLS) == set(INK) == set(VERDICT_NAMES.values())
    assert len(set(MARKS.values())) == len(MARKS)


def brightness(color: str) -> float:
    r, g, b = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return 0.299 * r + 0.587 * g + 0.114 * b


def test_verdicts_differ_in_grey_and_the_mark_stands_out():
    levels = sorted(brightness(FILLS[name]) for name in ("passed", "degraded", "failed"))
    assert min(b - a for a, b in zip(levels, levels[1:], strict=False)) > 0.1
    assert all(abs(brightness(FILLS[n]) - brightness(INK[n])) > 0.45 for n in FILLS)


def test_a_picture_of_28_methods_is_high_enough_for_their_names(tmp_path):
    from matplotlib.image import imread

    rows = [f"method-{i}" for i in range(28)]
    cells = {(row, "section"): Cell("passed", "36/36") for row in rows}
    draw_grid(cells, rows, ["section"], "Title", tmp_path / "grid.png")
    assert imread(tmp_path / "grid.png").shape[0] > 28 * 25  # pixels

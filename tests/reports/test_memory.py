"""The memory table: numbers of `rlbench speed` and the paper's account, computed by hand."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from reports.memory import main, memory_page
from reports.published import published

SPEED = pd.DataFrame(
    [
        ("ours/latent", 720, 720, 1000.0, 190.0, 200.0, 1000.0),
        ("ours/latent@openvino", 720, 720, 1000.0, 190.0, 200.0, float("nan")),
        ("ours/latent", 64, 64, 1000.0, 190.0, 201.0, 10.0),
        ("ours", 720, 720, 900.0, 100.0, 60.0, 500.0),
        ("mean", 720, 720, 0.0, 0.0, 0.0, 8.0),
        ("svgf", 720, 720, 0.0, 0.0, 45.0, float("nan")),
    ],
    columns=[
        "method", "height", "width", "parameters", "multiply_adds", "state_bytes", "memory_mb",
    ],
)  # fmt: skip


def cells(page, start):
    line = next(line for line in page.splitlines() if line.startswith(f"| {start}"))
    return [cell.strip() for cell in line.split("|")[2:-1]]


def test_each_method_has_a_line_at_the_papers_size_and_the_least_state_is_first():
    page = memory_page(SPEED)
    assert page.startswith("# Memory and work of a frame: 720 x 720\n")
    names = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert names == ["mean", "svgf", "ours", "ours/latent"]
    # 200 x 720² / 2²⁰
    assert cells(page, "`ours/latent`") == ["1000", "190.0", "200", "98.9", "1000"]
    assert cells(page, "`svgf`")[-1] == "-"


def test_the_papers_method_is_counted_as_the_paper_counts():
    page = memory_page(SPEED)
    assert "| paper | `ours/latent` here |" in page
    assert cells(page, "state, bytes") == ["128", "200"]
    assert cells(page, "state, 24 channels") == ["212", "284"]  # 200 + 4 x (24 + 7 - 10)
    assert cells(page, "the same") == ["110", "147"]  # 284 x 720² / 10⁶
    assert cells(page, "weights") == ["< 50", "4.0"]
    assert cells(page, "working") == ["a few MB, by tiles", "1049 MB, whole frame"]


def test_without_the_papers_size_the_largest_is_shown_and_its_megabytes_are_not():
    page = memory_page(SPEED[SPEED["width"] == 64])
    assert "64 x 64" in page.splitlines()[0]
    assert cells(page, "the same")[0] == "-"


def test_without_the_papers_method_there_is_no_comparison():
    assert "Beside the paper" in memory_page(SPEED)
    assert "Beside the paper" not in memory_page(SPEED[SPEED["method"] != "ours/latent"])


def test_the_published_account_adds_up():
    paper = published().memory
    added = paper.state_channels + paper.sample_channels + paper.guide_channels
    bytes_per_pixel = 4 * (added - paper.earlier_channels)
    assert bytes_per_pixel == paper.bytes_per_pixel
    assert bytes_per_pixel * paper.size**2 / 1e6 == pytest.approx(paper.megabytes, abs=0.5)


def test_the_page_lies_beside_the_table_it_is_made_from(tmp_path: Path):
    shipped = Path(__file__).parents[2] / "docs" / "results"
    (tmp_path / "speed.csv").write_bytes((shipped / "speed.csv").read_bytes())
    main(tmp_path)
    assert "ours" in (tmp_path / "memory.md").read_text()

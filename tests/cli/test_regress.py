"""The command regress, on results of small clips."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from junitparser import JUnitXml

from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
from rlbench.cli.regress import _compared_rows
from tests.cli.runner import rlbench


@pytest.fixture
def words(run_mean, tmp_path):
    """Results of `mean` at two budgets, and the words that compare them with their baseline."""
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench(*run_mean, "--spp", "1,2", "--times", "none")
    assert "2 entries written" in rlbench("regress", *words, "--update")
    return words


def raise_baseline(file, decibels):
    """Make the first entry better than the results."""
    content = json.loads(file.read_text())
    content["entries"][0]["psnr"] += decibels
    file.write_text(json.dumps(content))


def test_regress_refuses_a_method_that_nobody_measured(words):
    assert "passed: 2 same" in rlbench("regress", *words, "--methods", "mean")
    output = rlbench("regress", *words, "--methods", "mean,maen", code=2)
    message = "error: --methods maen: neither the results nor the baseline have it; available: mean"
    assert message in output


def test_a_fall_fails_and_a_part_of_the_results_rewrites_its_part_of_the_baseline(words, tmp_path):
    raise_baseline(tmp_path / "base.json", 1)
    assert "FAILED: 1 worse" in rlbench("regress", *words, code=1)
    rlbench("regress", *words, "--update", "--methods", "mean")
    assert "passed: 2 same" in rlbench("regress", *words)


def test_what_fell_is_written_as_junit_and_as_markdown_with_crops(
    words, clip_folder, tmp_path, monkeypatch
):
    raise_baseline(tmp_path / "base.json", 1)
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "job.md"))
    files = ("--junit", tmp_path / "o" / "r.xml", "--summary", tmp_path / "o" / "r.md")
    rlbench("regress", *words, *files, "--clips", clip_folder, code=1)
    (suite,) = JUnitXml.fromfile(str(tmp_path / "o" / "r.xml"))
    assert (suite.tests, suite.failures) == (2, 1)
    text = (tmp_path / "o" / "r.md").read_text()
    for name in ("reference", "now", "difference"):
        assert f"![{name}](r-crops/{name}.png)" in text
        assert (tmp_path / "o" / "r-crops" / f"{name}.png").stat().st_size > 0
    assert "| WORSE | mean | noise | 1 |" in (tmp_path / "job.md").read_text()


def test_a_summary_without_its_clip_says_so_and_keeps_the_verdict(words, tmp_path):
    raise_baseline(tmp_path / "base.json", 1)
    rlbench("regress", *words, "--summary", tmp_path / "r.md", code=1)
    assert "No crops of the worst change: clip noise is not here" in (tmp_path / "r.md").read_text()


def test_speed_gates_of_the_baseline_and_of_the_option_are_measured(words, tmp_path):
    content = json.loads((tmp_path / "base.json").read_text())
    (tmp_path / "base.json").write_text(json.dumps({**content, "speed": ["mean / eaw <= 1e6"]}))
    output = rlbench("regress", *words, "--speed", "eaw/mean<=1e6")
    assert ": mean / eaw <= 1e+06" in output
    assert ": eaw / mean <= 1e+06" in output
    output = rlbench("regress", *words, "--speed", "eaw/maen<=1", code=2)
    assert "names no two installed methods" in output


def test_a_shipped_baseline_is_compared_in_the_rows_that_there_are():
    shipped = load_baseline(find_baseline("mini"))
    rows = pd.DataFrame({"method": ["oidn", "ours"]})
    assert _compared_rows([], rows, shipped, "") == ["oidn", "ours"]
    assert _compared_rows(["svgf"], rows, shipped, "mini") == ["svgf"]
    assert _compared_rows(["all"], rows, shipped, "") == []  # every row of the baseline
    assert _compared_rows([], rows, shipped, "mine.json") == []

"""The Markdown of the regression check shows what failed, and its crops where a page can."""

from __future__ import annotations

import markdown_it
import pytest

from rlbench.benchmark.regression.comparison import compare
from rlbench.benchmark.regression.crops import Crops
from rlbench.benchmark.regression.pages import append_to_job_summary, markdown, write_summary
from rlbench.benchmark.results import to_dataframe
from tests.benchmark.regression.examples import baseline, rows


@pytest.fixture
def report():
    return compare(to_dataframe(rows(29.0) + rows(12.0, method="a|b")), baseline(stderr_db=0.5))


@pytest.fixture
def crops(tmp_path):
    names = ("reference", "now", "difference")
    return Crops("ours on city", {name: tmp_path / "r-crops" / f"{name}.png" for name in names})


def table_cells(text: str) -> list[list[str]]:
    """The tables of a page as a Markdown parser reads them, line by line."""
    lines: list[list[str]] = []
    for token in markdown_it.MarkdownIt().enable("table").parse(text):
        if token.type == "tr_open":
            lines.append([])
        elif token.type == "inline" and lines:
            lines[-1].append(token.content)
    return lines


def test_the_table_has_the_lines_that_differ(report):
    head, worse, new = table_cells(markdown(report))
    assert head == [
        "verdict",
        "method",
        "scene",
        "spp",
        "baseline",
        "+-",
        "measured",
        "change",
        "allowed",
    ]
    assert worse == ["WORSE", "ours", "city", "2", "30.000", "0.500", "29.000", "-1.000", "-0.050"]
    assert new[:3] == ["new", "a|b", "city"]
    assert "**FAILED: 1 worse, 1 new**" in markdown(report)


def test_equal_results_have_no_table():
    text = markdown(compare(to_dataframe(rows(30.0)), baseline()))
    assert text == "## rlbench regress\n\n**passed: 1 same**\n"


def test_a_page_links_the_crops_beside_it(report, crops, tmp_path):
    write_summary(report, crops, tmp_path / "r.md")
    text = (tmp_path / "r.md").read_text()
    assert "### Worst change: ours on city" in text
    assert "| ![reference](r-crops/reference.png) | ![now](r-crops/now.png) |" in text


def test_the_summary_of_a_job_is_appended_and_names_the_artefacts(
    report, crops, tmp_path, monkeypatch
):
    (tmp_path / "job.md").write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "job.md"))
    append_to_job_summary(report, crops)
    text = (tmp_path / "job.md").read_text()
    assert text.startswith("before\n## rlbench regress")
    assert "Crops (reference, now, difference) are in the artefacts of this run: `r-crops`" in text
    assert "![" not in text


def test_without_a_job_nothing_is_appended(report, crops, tmp_path, monkeypatch):
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    monkeypatch.chdir(tmp_path)
    append_to_job_summary(report, crops)
    assert not list(tmp_path.iterdir())


def test_a_page_without_crops_says_why(report):
    assert "No crops of the worst change: clip city is not here" in markdown(
        report, "clip city is not here"
    )

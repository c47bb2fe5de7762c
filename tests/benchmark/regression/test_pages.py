"""What a check writes: Markdown for pull requests, JUnit XML by another library and the schema."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import markdown_it
import pytest
import xmlschema
from junitparser import Failure, JUnitXml, Skipped

from rlbench.benchmark.regression.baseline import BaselineEntry
from rlbench.benchmark.regression.comparison import SpeedGate, SpeedResult, compare
from rlbench.benchmark.regression.crops import Crops
from rlbench.benchmark.regression.pages import (
    append_to_job_summary,
    markdown,
    write_junit,
    write_summary,
)
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
    _, worse, new = table_cells(markdown(report))
    assert worse == ["WORSE", "ours", "city", "2", "30.000", "0.500", "29.000", "-1.000", "-0.050"]
    assert new[:3] == ["new", "a|b", "city"]
    assert "**FAILED: 1 worse, 1 new**" in markdown(report)
    assert [line.split() for line in report.text().splitlines() if "WORSE" in line] == [worse]
    assert report.text().splitlines()[-1] == "FAILED: 1 worse, 1 new"


def test_a_page_links_the_crops_beside_it_and_the_summary_of_a_job_names_them(
    report, crops, tmp_path, monkeypatch
):
    write_summary(report, crops, tmp_path / "r.md")
    text = (tmp_path / "r.md").read_text()
    assert "### Worst change: ours on city" in text
    assert "| ![reference](r-crops/reference.png) | ![now](r-crops/now.png) |" in text
    (tmp_path / "job.md").write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "job.md"))
    append_to_job_summary(report, crops)
    text = (tmp_path / "job.md").read_text()
    assert text.startswith("before\n## rlbench regress")
    assert "Crops (reference, now, difference) are in the artefacts of this run: `r-crops`" in text
    assert "![" not in text


SCHEMA = xmlschema.XMLSchema(Path(__file__).parent / "data" / "junit.xsd")


@pytest.fixture
def every_verdict():
    """One cell of each verdict, and three gates."""
    psnrs = {"worse": 29.0, "lower": 29.97, "same": 30.0, "better": 31.0}
    found = [row for scene, psnr in psnrs.items() for row in rows(psnr, scene=scene)]
    entries = (BaselineEntry("ours", scene, 2.0, 30.0) for scene in (*psnrs, "skipped"))
    gone = BaselineEntry("gone<&\x00>", "city", 2.0, 30.0)
    gate = SpeedGate("ours", "ours/latent", 0.9)
    speed = (
        SpeedResult(gate, "slower", 1.0, 0.95, 1.05),
        SpeedResult(gate, "within", 0.8, 0.75, 0.85),
        SpeedResult(gate, "undecided", reason="the machine was busy"),
    )
    written = replace(baseline(), entries=(*entries, gone))
    table = to_dataframe(found + rows(30.0, scene="new"))
    return replace(compare(table, written, subset=True), speed=speed)


def test_each_cell_and_each_gate_is_a_test_case(every_verdict, tmp_path):
    write_junit(every_verdict, tmp_path / "out" / "r.xml", datetime(2026, 1, 2, 3, 4, 5))
    SCHEMA.validate(tmp_path / "out" / "r.xml")
    (suite,) = JUnitXml.fromfile(str(tmp_path / "out" / "r.xml"))  # as another library reads it
    assert len(list(suite)) == len(every_verdict.diffs) + len(every_verdict.speed) == 10
    assert (suite.tests, suite.failures, suite.skipped, suite.errors) == (10, 3, 3, 0)
    assert suite.timestamp == "2026-01-02T03:04:05"
    results = {case.name: case.result[0] for case in suite if case.result}
    assert {name: type(result) for name, result in results.items()} == {
        "worse at 2 spp": Failure,
        "city at 2 spp": Failure,  # missing
        "ours / ours/latent": Skipped,  # the last of three gates of one name
        "new at 2 spp": Skipped,
        "skipped at 2 spp": Skipped,
    }
    assert results["worse at 2 spp"].message == (
        "expected 30.000 dB, measured 29.000 dB (-1.000), allowed fall 0.050 dB"
    )
    assert results["city at 2 spp"].message == "expected 30.000 dB, measured nothing"
    (slower,) = (case.result[0] for case in suite if case.is_failure and "/" in case.name)
    assert (slower.type, "1.000 [0.950, 1.050]" in slower.message) == ("slower", True)

"""JUnit XML of the regression check, read by another library and checked against the schema."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest
import xmlschema
from junitparser import Failure, JUnitXml, Skipped

from rlbench.benchmark.regression.baseline import BaselineEntry
from rlbench.benchmark.regression.comparison import SpeedGate, SpeedResult, compare
from rlbench.benchmark.regression.pages import write_junit
from rlbench.benchmark.results import to_dataframe
from tests.benchmark.regression.examples import baseline, rows

SCHEMA = xmlschema.XMLSchema(Path(__file__).parent / "data" / "junit.xsd")
GATE = SpeedGate("ours", "ours/latent", 0.9)


@pytest.fixture
def report():
    """One cell of each verdict, and three gates."""
    psnrs = {"worse": 29.0, "lower": 29.97, "same": 30.0, "better": 31.0}
    found = [row for scene, psnr in psnrs.items() for row in rows(psnr, scene=scene)]
    entries = (BaselineEntry("ours", scene, 2.0, 30.0) for scene in (*psnrs, "skipped"))
    gone = BaselineEntry("gone<&\x00>", "city", 2.0, 30.0)
    table = to_dataframe(found + rows(30.0, scene="new"))
    speed = (
        SpeedResult(GATE, "slower", 1.0, 0.95, 1.05),
        SpeedResult(GATE, "within", 0.8, 0.75, 0.85),
        SpeedResult(GATE, "undecided", reason="the machine was busy"),
    )
    written = replace(baseline(), entries=(*entries, gone))
    return replace(compare(table, written, subset=True), speed=speed)


@pytest.fixture
def suite(report, tmp_path):
    """The written file, as junitparser reads it."""
    write_junit(report, tmp_path / "out" / "r.xml", datetime(2026, 1, 2, 3, 4, 5))
    SCHEMA.validate(tmp_path / "out" / "r.xml")
    (suite,) = JUnitXml.fromfile(str(tmp_path / "out" / "r.xml"))
    return suite


def test_each_cell_and_each_gate_is_a_test_case(suite, report):
    assert len(list(suite)) == len(report.diffs) + len(report.speed) == 10
    assert (suite.tests, suite.failures, suite.skipped, suite.errors) == (10, 3, 3, 0)
    assert suite.timestamp == "2026-01-02T03:04:05"


def test_a_failure_says_what_was_expected_measured_and_allowed(suite):
    failures = {case.name: case.result[0] for case in suite if case.is_failure}
    assert failures["worse at 2 spp"].message == (
        "expected 30.000 dB, measured 29.000 dB (-1.000), allowed fall 0.050 dB"
    )
    assert failures["city at 2 spp"].message == "expected 30.000 dB, measured nothing"
    assert failures["ours / ours/latent"].type == "slower"
    assert "measured 1.000 [0.950, 1.050]" in failures["ours / ours/latent"].message


def test_failures_are_those_of_the_report_and_what_was_not_compared_is_skipped(suite, report):
    results = {case.name: type(case.result[0]) for case in suite if case.result}
    cells = {f"{d.key.scene} at 2 spp": d.verdict for d in report.diffs}
    expected = {"worse": Failure, "missing": Failure, "new": Skipped, "skipped": Skipped}
    for name, verdict in cells.items():
        assert results.get(name) == expected.get(verdict)


def test_the_schema_refuses_a_report_without_its_counts(report, tmp_path):
    write_junit(report, tmp_path / "r.xml")
    text = (tmp_path / "r.xml").read_text().replace('tests="10"', "")
    with pytest.raises(xmlschema.XMLSchemaValidationError, match="tests"):
        SCHEMA.validate(text)

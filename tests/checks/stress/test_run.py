"""`rlbench stress` prints a verdict per test, writes a table, and its exit code sums them up."""

from __future__ import annotations

import csv
import json

import pytest
import torch
from rich.console import Console
from typer.testing import CliRunner

from rlbench.checks.result import CheckResult, Limits, Verdict, judge, not_applicable
from rlbench.checks.stress import run
from rlbench.checks.stress.jobs import FinishedJob, StressJob
from rlbench.checks.stress.run import print_summary, write_tables
from rlbench.cli.app import app
from tests.conftest import install_plugin, write_plugin

FAULT = Limits(good=256, fair=1000, unit="pixels")
RESULTS = (
    judge("sample-nan", 12, FAULT),
    judge("depth-nan", 700, FAULT, remedy="clamp depth"),
    judge("depth-inf", float("inf"), FAULT, remedy="clamp depth"),
    not_applicable("run", "has no weights"),
)


def finished(section: str, *results: CheckResult) -> FinishedJob:
    return FinishedJob(StressJob(section, "toy", True, "cpu"), results)


JOBS = [
    finished("bad-pixel", *RESULTS),
    finished("budgets", judge("size-1x1", 0, Limits(0, 0, "pixels"))),
]


def stress(*arguments: object, code: int):
    words = [str(word) for word in ("stress", *arguments, "--quick")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == code, result.output
    return result.stdout.splitlines(), result.stderr.splitlines()


def test_verdicts_are_printed_per_method_and_test_with_progress_on_the_error_stream(tmp_path):
    lines, progress = stress("mean", "--only", "budgets", "--out", tmp_path, code=0)
    assert lines[0] == "mean: budgets"
    assert lines[1] == "  ✓ spp-0: 0 wrong pixels (at most 0)"
    assert "  - density-half: the method samples uniformly" in lines
    assert lines[-1].startswith("passed: ")
    assert progress == ["[1/1] mean: budgets"]


def test_a_failed_test_is_printed_with_its_remedy_and_exit_code_1(tmp_path):
    body = "return samples.radiance.sum(1) / samples.counts, None"
    plugin = write_plugin(tmp_path / "toy.py", "toy", body=body)
    arguments = ("toy", "--only", "budgets", "--plugin", plugin, "--out", tmp_path)
    lines, _ = stress(*arguments, code=1)
    (line,) = [line for line in lines if "✗" in line]
    assert line == (
        "  ✗ spp-0: 3072 wrong pixels (at most 0), 3072 pixels of frame 0 are not finite -> "
        "return a finite float32 image [n 3 h w] for any budget, density and size"
    )
    again, progress = stress(*arguments, code=1)
    assert again == lines
    assert progress == ["[1/1] toy: budgets, from an earlier run"]


@pytest.mark.slow
def test_sections_of_the_suite_run_without_methods_or_by_name_alone(tmp_path):
    """A method's exit code does not depend on the suite's own verdicts."""
    _, progress = stress("mean", "--out", tmp_path, code=0)
    assert all(": " in line for line in progress)  # METHOD: SECTION
    _, progress = stress("mean", "--only", "budgets,metrics", "--out", tmp_path, code=0)
    assert sorted(line.split("] ")[1].split(",")[0] for line in progress) == [
        "mean: budgets",
        "metrics",
    ]


def test_a_family_that_cannot_be_imported_is_a_failure_of_all(tmp_path, monkeypatch):
    monkeypatch.setattr("rlbench.checks.stress.run.plan_jobs", lambda *_: [])
    install_plugin(tmp_path, monkeypatch, "methods", "torn = no_such_module:FAMILY")
    lines, _ = stress("--only", "budgets", "--out", tmp_path, code=1)
    assert any(line.startswith("failed: 'all' skips torn, which cannot be ") for line in lines)


def test_an_unknown_section_ends_with_exit_code_2(tmp_path):
    _, errors = stress("mean", "--only", "budget", "--out", tmp_path, code=2)
    assert errors[0] == "error: --only budget: no such section. Did you mean 'budgets'?"


def test_planted_bad_pixels_are_counted_in_the_last_line_without_shares_of_faults():
    share = CheckResult("unsanitized", Verdict.SKIPPED, figure=50.0, limits=Limits(unit="%"))
    console = Console(record=True, width=200, quiet=False)
    with console.capture() as capture:
        print_summary([*JOBS, finished("bad-pixel", share)], console)
    assert capture.get().splitlines() == [
        "passed: 2, degraded: 1, failed: 1, skipped: 2",
        "planted bad pixels: 1 of 3 contained",
    ]


def test_tables_hold_every_result(tmp_path):
    table, document = write_tables(JOBS, tmp_path, True, "cpu")
    rows = list(csv.DictReader(table.open()))
    assert [row["test"] for row in rows] == [*(result.check for result in RESULTS), "size-1x1"]
    assert [row["verdict"] for row in rows] == ["passed", "degraded", "failed", "skipped", "passed"]
    assert [row["figure"] for row in rows] == ["12", "700", "inf", "", "0"]
    content = json.loads(document.read_text(), parse_constant=lambda name: 1 / 0)  # no NaN
    assert content["quick"] is True
    assert [row["figure"] for row in content["results"]] == [12, 700, None, None, 0]


def test_a_run_without_methods_leaves_out_rows_that_borrow_their_weights(tmp_path, monkeypatch):
    planned = []

    def plan(methods, *rest):
        planned.extend(methods)
        return []

    monkeypatch.setattr(run, "plan_jobs", plan)
    run.stress_methods([], ["budgets"], True, torch.device("cpu"), tmp_path)
    assert "oidn/tuned" in planned
    assert "accumulate/contrast" not in planned

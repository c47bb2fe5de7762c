"""A correct method passes all checks, and each fault fails exactly its own check."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest
import torch

from rlbench import registry
from rlbench.checks import conformance
from rlbench.checks.conformance import (
    CHECKS,
    MethodUnderTest,
    Verdict,
    run_check,
    run_checks,
)
from rlbench.checks.conformance.method_under_test import RecordingMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.nested_tensors import is_bit_equal, iterate_tensors
from rlbench.run import run_clip
from tests.checks.conformance.broken_fixtures import FAULTS, SIZE, SMALL_SIZE, Correct
from tests.conftest import install_plugin, write_plugin


@pytest.fixture(autouse=True)
def _faulty_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    target = "tests.checks.conformance.broken_fixtures:FAMILY"
    install_plugin(tmp_path / "installed", monkeypatch, "methods", f"faulty = {target}")


def faulty(variant: str) -> MethodUnderTest:
    return MethodUnderTest(f"faulty/{variant}", size=SIZE, small_size=SMALL_SIZE)


def verdicts(variant: str) -> dict[str, Verdict]:
    return {check.name: result.verdict for check, result in run_checks(faulty(variant))}


@pytest.mark.parametrize(
    ("variant", "skipped"),
    [("correct", {"uniform", "temporal", "receptive_field"}), ("stateless", set())],
)
def test_a_correct_method_passes_every_check_that_applies(variant, skipped):
    found = verdicts(variant)
    assert {name for name in found if found[name] is not Verdict.PASSED} == skipped
    assert all(found[name] is Verdict.SKIPPED for name in skipped)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_fails_its_own_check_and_no_other(fault):
    failed = [name for name, verdict in verdicts(fault).items() if verdict is Verdict.FAILED]
    assert failed == [FAULTS[fault].check]


def test_every_check_has_a_fault_that_it_finds():
    assert set(CHECKS) == {fault.check for fault in FAULTS.values()}


def test_a_failed_check_says_what_was_expected_what_was_found_and_how_to_fix_it():
    result = run_check(faulty("draws half of its budget"), "budget")
    expected = round(0.6 * SIZE.h * SIZE.w)
    half = [round(0.3 * SIZE.h * SIZE.w)] * 3
    assert result.found == f"expected {expected} samples per frame (0.6 spp), found {half}"
    assert result.remedy == "let Traits(passes=...) end with 1.0"


def test_an_exception_is_reported_with_the_budget_at_which_it_was_raised():
    result = run_check(faulty("max_samples below its budgets"), "spp_range")
    assert result.found.startswith("raised ")
    assert result.found.endswith("at 8 spp")
    assert result.error is not None


def test_a_check_that_does_not_apply_says_why():
    result = run_check(faulty("correct"), "temporal")
    assert (result.verdict, result.found) == (Verdict.SKIPPED, "Traits(temporal=True)")


def test_a_check_runs_once():
    method = faulty("correct")
    assert run_check(method, "budget") is run_check(method, "budget")


def test_every_requirement_is_printed_once():
    requirements = [check.requirement for check in CHECKS.values()]
    assert len(set(requirements)) == len(requirements)


def test_reads_densities_and_counts_are_recorded():
    recording = RecordingMethod(Correct())
    list(run_clip(recording, procedural_clip(size=Size(1, 12, 16), frames=2), 1.0))
    assert recording.buffers_read == {"albedo", "motion"}
    assert len(recording.densities) == len(recording.counts) == 2
    assert recording.modified == set()


def test_nan_is_bit_equal_to_nan_and_types_differ():
    nan = torch.tensor([1.0, torch.nan])
    assert is_bit_equal(nan, nan.clone())
    assert not is_bit_equal(nan, nan.double())


def test_tensors_of_a_nested_state_are_found():
    one, two = torch.zeros(1), torch.ones(1)
    assert [float(t) for t in iterate_tensors({"a": [one], "b": (two, "text")})] == [0.0, 1.0]


# the package, in the tests of a plugin


def run_documented_test(tmp_path, method: str, **plugin: str) -> list[tuple[str, str]]:
    """The outcome and the text of each test of the package's docstring, for another method."""
    outcomes: list[tuple[str, str]] = []

    class Collect:
        def pytest_runtest_logreport(self, report):
            if report.when == "call":
                outcomes.append((report.outcome, report.longreprtext))

    documentation = conformance.__doc__ or ""
    start, end = documentation.index("    import pytest"), documentation.index("`method` runs once")
    code = textwrap.dedent(documentation[start:end]).replace('"mean"', f'"{method}"')
    registry.use_plugin(write_plugin(tmp_path / f"{method}.py", method, **plugin))
    file = tmp_path / f"test_{method}.py"  # pytest imports each file name only once
    file.write_text(code)
    options = ["-q", "-p", "no:cacheprovider", "--import-mode=importlib", f"--rootdir={tmp_path}"]
    pytest.main([str(file), *options], [Collect()])
    return outcomes


def test_the_documented_lines_run_one_test_per_check(tmp_path):
    outcomes = run_documented_test(tmp_path, "correct")
    assert [outcome for outcome, _ in outcomes] == ["passed"] * len(CHECKS)


def test_the_documented_lines_fail_with_what_was_found_and_how_to_fix_it(tmp_path):
    outcomes = run_documented_test(tmp_path, "double", body="return samples.mean.double(), None")
    (text,) = [text for outcome, text in outcomes if outcome == "failed"]
    assert "found torch.float64" in text
    assert "-> end with .float()" in text

"""A correct method passes all checks, and each fault fails exactly its own check."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.checks.conformance import CHECKS, MethodUnderTest, Verdict, run_check, run_checks
from tests.checks.conformance.broken_fixtures import FAULTS, SIZE, SMALL_SIZE


@pytest.fixture(autouse=True)
def _faulty_family(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(
        registry.METHODS_VARIABLE, "faulty=tests.checks.conformance.broken_fixtures:FAMILY"
    )


def method_under_test(variant: str) -> MethodUnderTest:
    return MethodUnderTest(f"faulty/{variant}", size=SIZE, small_size=SMALL_SIZE)


def verdicts(variant: str) -> dict[str, Verdict]:
    results = run_checks(method_under_test(variant))
    return {check.name: result.verdict for check, result in results}


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


@pytest.mark.parametrize("name", CHECKS)
def test_every_check_has_a_fault_that_it_finds(name):
    assert name in {fault.check for fault in FAULTS.values()}


def test_a_failed_check_says_what_was_expected_what_was_found_and_how_to_fix_it():
    result = run_check(method_under_test("draws half of its budget"), "budget")
    expected = round(0.6 * SIZE.h * SIZE.w)
    half = [round(0.3 * SIZE.h * SIZE.w)] * 3
    assert result.found == f"expected {expected} samples per frame (0.6 spp), found {half}"
    assert result.remedy == "let Traits(passes=...) end with 1.0"


def test_an_exception_is_reported_with_the_budget_at_which_it_was_raised():
    result = run_check(method_under_test("max_samples below its budgets"), "spp_range")
    assert result.found.startswith("raised ")
    assert result.found.endswith("at 8 spp")
    assert result.error is not None


def test_a_check_that_does_not_apply_says_why():
    result = run_check(method_under_test("correct"), "temporal")
    assert (result.verdict, result.found) == (Verdict.SKIPPED, "Traits(temporal=True)")


def test_a_check_runs_once():
    method = method_under_test("correct")
    assert run_check(method, "budget") is run_check(method, "budget")


def test_every_requirement_is_printed_in_the_imperative_and_once():
    requirements = [check.requirement for check in CHECKS.values()]
    assert len(set(requirements)) == len(requirements)
    verbs = {requirement.split()[0] for requirement in requirements}
    assert verbs == {
        "be", "build", "declare", "depend", "discard", "draw", "leave", "return", "run", "treat",
        "use",
    }  # fmt: skip

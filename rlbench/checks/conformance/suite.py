"""The conformance suite: run one check or all checks, and select the methods to check."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import torch

from rlbench import registry
from rlbench.checks.conformance.checks import CHECKS, Check
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.result import (
    CheckResult,
    Verdict,
    failed,
    not_applicable,
    passed,
)
from rlbench.checks.returns import Fault, WrongReturnError

__all__ = ["CheckResult", "Verdict", "run_check", "run_checks"]


def run_check(method_under_test: MethodUnderTest, name: str) -> CheckResult:
    """The result of one check, by its name in `CHECKS`; a repeated call returns the same result.

    It is SKIPPED where the method cannot run on this machine, the check does not apply, or a check
    that it requires did not pass. An exception of the method is a failure.

    >>> print(run_check(MethodUnderTest("mean"), "temporal"))
    depend on one frame alone unless declared temporal
    """
    results = method_under_test.results
    if name not in results:
        results[name] = _run(method_under_test, CHECKS[name])
    return results[name]


def run_checks(method_under_test: MethodUnderTest) -> Iterator[tuple[Check, CheckResult]]:
    """Every check with its result, one after the other."""
    for name, check in CHECKS.items():
        yield check, run_check(method_under_test, name)


def select_methods(patterns: Iterable[str], device: torch.device) -> list[MethodUnderTest]:
    """The methods that match the patterns of `registry.expand`.

    `all` stands for every variant of every family that can be imported. Raises PluginError for an
    unknown name.
    """
    families = registry.list_plugins("methods")
    usable = [f"{name}/*" for name in families if not registry.import_error("methods", name)]
    names = [name for each in patterns for name in (usable if each == "all" else [each])]
    return [MethodUnderTest(name, device) for name in registry.expand(names, pretrained_only=False)]


def find_broken_families() -> dict[str, str]:
    """The import error of each method family that cannot be imported, by its name."""
    errors = {
        name: registry.import_error("methods", name) for name in registry.list_plugins("methods")
    }
    return {name: error for name, error in errors.items() if error}


def _run(method_under_test: MethodUnderTest, check: Check) -> CheckResult:
    label = check.requirement
    if reason := _skip_reason(method_under_test, check):
        return not_applicable(label, reason)
    try:
        with registry.exits_as_errors():
            fault = check.find_fault(method_under_test)
    except WrongReturnError as error:
        fault = error.fault
    except Exception as error:  # whatever a method raises is reported
        reason = registry.failure_reason(method_under_test.name, error)
        return failed(label, f"raised {reason}", check.remedy, error)
    if isinstance(fault, Fault):
        return failed(label, *fault)
    return failed(label, fault, check.remedy) if fault else passed(label)


def _skip_reason(method_under_test: MethodUnderTest, check: Check) -> str | None:
    if method_under_test.unavailable_reason:
        return method_under_test.unavailable_reason
    for name in check.requires:
        if run_check(method_under_test, name).verdict is not Verdict.PASSED:
            return f"requires a passed check: {CHECKS[name].requirement}"
    return check.skip_reason(method_under_test.traits)

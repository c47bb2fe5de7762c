"""Run one check of a method, or all checks of several methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import torch
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from rlbench import registry
from rlbench.checks.conformance import interface_checks, recording_checks, state_checks
from rlbench.checks.conformance.method_under_test import Check, MethodUnderTest
from rlbench.checks.result import CheckResult, Verdict, failed, not_applicable, passed
from rlbench.returns import Fault, WrongReturnError
from rlbench.system.progress import LoggedProgress

CHECKS = {  # in the order in which they are defined
    check.name: check
    for module in (interface_checks, state_checks, recording_checks)
    for check in vars(module).values()
    if isinstance(check, Check)
}
IMPORTABLE = "correct the line named in the error; `rlbench list methods` shows it again"
COLUMNS = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())


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


def check_methods(
    patterns: Sequence[str], device: torch.device
) -> Iterator[tuple[str, Iterable[CheckResult]]]:
    """The name of each selected method, and the results of all checks as they are made.

    A family that cannot be imported has failed: with `all` each, otherwise those of
    `registry.with_broken`. Raises PluginError for an unknown name.
    """
    methods = select_methods(patterns, device)
    broken = _find_import_errors() if "all" in patterns else {}
    for each in methods:
        if failure := registry.import_failure(each.name):
            broken[each.name] = str(failure)
    methods = [each for each in methods if each.name not in broken]
    for name, error in broken.items():
        yield name, [failed("be importable", error, IMPORTABLE)]
    noun = "method" if len(methods) == 1 else "methods"
    with LoggedProgress(*COLUMNS, TimeRemainingColumn(), transient=True) as bar:
        bar.console.print(
            f"{len(methods)} {noun}, {len(CHECKS)} checks each: seconds for a method without "
            "networks, up to a minute for a large network on a CPU",
            highlight=False,
            soft_wrap=True,
        )
        bar.add_task("checking", total=len(methods) * len(CHECKS))
        for each in methods:
            yield each.name, _results(each, bar)


def select_methods(patterns: Iterable[str], device: torch.device) -> list[MethodUnderTest]:
    """The methods that match the patterns of `registry.expand`.

    `all` stands for every variant of every family that can be imported. Raises PluginError for an
    unknown name.
    """
    broken = _find_import_errors()
    usable = [f"{name}/*" for name in registry.list_plugins("methods") if name not in broken]
    names = [name for each in patterns for name in (usable if each == "all" else [each])]
    return [MethodUnderTest(name, device) for name in registry.expand(names, pretrained_only=False)]


def _find_import_errors() -> dict[str, str]:
    """The import error of each method family that cannot be imported, by its name."""
    names = registry.list_plugins("methods")
    return {name: error for name in names if (error := registry.import_error("methods", name))}


def _results(tested: MethodUnderTest, bar: LoggedProgress) -> Iterator[CheckResult]:
    """The result of every check, shown on the bar; or the reason why none can run here."""
    (task,) = bar.task_ids
    if reason := tested.unavailable_reason:
        bar.advance(task, len(CHECKS))
        yield not_applicable("run on this machine", reason)
        return
    for name, check in CHECKS.items():
        bar.update(task, description=f"{tested.name}: {check.requirement}")
        result = run_check(tested, name)
        bar.advance(task)
        yield result


def _run(tested: MethodUnderTest, check: Check) -> CheckResult:
    label = check.requirement
    if reason := _skip_reason(tested, check):
        return not_applicable(label, reason)
    try:
        with registry.exits_as_errors():
            fault = check.find_fault(tested)
    except WrongReturnError as error:
        fault = error.fault
    except Exception as error:  # whatever a method raises is reported
        reason = registry.failure_reason(tested.name, error)
        return failed(label, f"raised {reason}", check.remedy, error)
    if isinstance(fault, Fault):
        return failed(label, *fault)
    return failed(label, fault, check.remedy) if fault else passed(label)


def _skip_reason(tested: MethodUnderTest, check: Check) -> str | None:
    if tested.unavailable_reason:
        return tested.unavailable_reason
    for name in check.requires:
        if run_check(tested, name).verdict is not Verdict.PASSED:
            return f"requires a passed check: {CHECKS[name].requirement}"
    return check.skip_reason(tested.traits)

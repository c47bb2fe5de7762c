"""Check methods and print a tick list for each: the command `rlbench check`."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from functools import partial

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn

from rlbench import registry
from rlbench.checks.conformance.checks import CHECKS
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import find_broken_families, run_check, select_methods
from rlbench.checks.console import OnResults, print_results
from rlbench.checks.result import CheckResult, failed, not_applicable
from rlbench.system.progress import LoggedProgress

IMPORTABLE = "correct the line named in the error; `rlbench list methods` shows it again"
COLUMNS = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())


def check_methods(
    patterns: Sequence[str],
    device: torch.device,
    debug: bool = False,
    on_results: OnResults | None = None,
) -> bool:
    """Run all checks on the selected methods and print the results. Returns False if one failed.

    With `debug`, the traceback of an exception follows its line. `on_results` receives the results
    and the name of each method in place of the printing. A family that cannot be imported has
    failed: with `all` each, otherwise those of `registry.with_broken`. Raises PluginError for an
    unknown name.
    """
    console = Console(quiet=on_results is not None)
    show = on_results or partial(print_results, console=console)
    methods = select_methods(patterns, device)
    broken = find_broken_families() if "all" in patterns else {}
    for each in methods:
        if failure := registry.import_failure(each.name):
            broken[each.name] = str(failure)
    methods = [each for each in methods if each.name not in broken]
    for name, error in broken.items():
        show([failed("be importable", error, IMPORTABLE)], title=name)
    noun = "method" if len(methods) == 1 else "methods"
    nonconforming = list(broken)
    with LoggedProgress(*COLUMNS, TimeRemainingColumn(), transient=True) as bar:
        bar.console.print(
            f"{len(methods)} {noun}, {len(CHECKS)} checks each: seconds for a method without "
            "networks, up to a minute for a large network on a CPU",
            highlight=False,
            soft_wrap=True,
        )
        task = bar.add_task("checking", total=len(methods) * len(CHECKS))
        for each in methods:
            results = _results(each, console, bar, task, debug)
            if not show(results, title=each.name):
                nonconforming.append(each.name)
    summary = f"failed: {', '.join(nonconforming)}" if nonconforming else "none failed"
    console.print(f"{len(methods)} {noun} checked; {summary}")
    return not nonconforming


def _results(
    method_under_test: MethodUnderTest,
    console: Console,
    bar: LoggedProgress,
    task: TaskID,
    debug: bool,
) -> Iterator[CheckResult]:
    """The result of every check, shown on the bar; or the reason why none can run here."""
    if reason := method_under_test.unavailable_reason:
        bar.advance(task, len(CHECKS))
        yield not_applicable("run on this machine", reason)
        return
    for name, check in CHECKS.items():
        bar.update(task, description=f"{method_under_test.name}: {check.requirement}")
        result = run_check(method_under_test, name)
        bar.advance(task)
        yield result
        if debug and result.error:
            lines = traceback.format_exception(result.error)
            console.print("".join(lines), markup=False, highlight=False, soft_wrap=True)

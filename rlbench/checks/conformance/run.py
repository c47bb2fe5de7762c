"""Check methods and print a tick list for each: the command `rlbench check`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from rich.console import Console

from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import find_broken_families, run_checks, select_methods
from rlbench.checks.console import OnResults, print_results
from rlbench.checks.result import failed, not_applicable


def check_methods(
    patterns: Sequence[str], device: torch.device, on_results: OnResults | None = None
) -> bool:
    """Run all checks on the selected methods and print the results. Returns False if one failed.

    `on_results` receives the results and the name of each method in place of the printing. With
    `all`, a family that cannot be imported has failed. Raises PluginError for an unknown name.
    """
    console = Console(quiet=on_results is not None)
    show = on_results or partial(print_results, console=console)
    broken = find_broken_families() if "all" in patterns else {}
    for name, error in broken.items():
        fix = "correct the module named in the error; `rlbench list methods` shows it again"
        show([failed("be importable", error, fix)], title=name)
    methods = select_methods(patterns, device)
    nonconforming = [*broken, *(each.name for each in methods if not _check(each, show))]
    summary = f"failed: {', '.join(nonconforming)}" if nonconforming else "none failed"
    noun = "method" if len(methods) == 1 else "methods"
    console.print(f"{len(methods)} {noun} checked; {summary}")
    return not nonconforming


def _check(method_under_test: MethodUnderTest, show: OnResults) -> bool:
    name = method_under_test.name
    if reason := method_under_test.unavailable_reason:
        skipped = not_applicable("run on this machine", reason)
        return show([skipped], title=name)
    results = (result for _, result in run_checks(method_under_test))
    return show(results, title=name)

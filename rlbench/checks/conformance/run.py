"""Check methods and print a tick list for each: the command `rlbench check`."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from rich.console import Console

from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import find_broken_families, run_checks, select_methods
from rlbench.checks.console import print_results
from rlbench.checks.result import failed, not_applicable


def check_methods(patterns: Sequence[str], device: torch.device) -> bool:
    """Run all checks on the selected methods and print the results. Returns False if one failed.

    With `all`, a family that cannot be imported has failed. Raises PluginError for an unknown name.
    """
    console = Console()
    broken = find_broken_families() if "all" in patterns else {}
    for name, error in broken.items():
        fix = "correct the module named in the error; `rlbench list methods` shows it again"
        print_results([failed("be importable", error, fix)], console, title=name)
    methods = select_methods(patterns, device)
    nonconforming = [*broken, *(each.name for each in methods if not _check(each, console))]
    summary = f"failed: {', '.join(nonconforming)}" if nonconforming else "none failed"
    noun = "method" if len(methods) == 1 else "methods"
    console.print(f"{len(methods)} {noun} checked; {summary}")
    return not nonconforming


def _check(method_under_test: MethodUnderTest, console: Console) -> bool:
    name = method_under_test.name
    if reason := method_under_test.unavailable_reason:
        skipped = not_applicable("run on this machine", reason)
        return print_results([skipped], console, title=name)
    results = (result for _, result in run_checks(method_under_test))
    return print_results(results, console, title=name)

"""The tick list: one line a claim, what was asked, what was found, and what would do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import torch
from rich.console import Console
from rich.markup import escape

from rlbench.checks.conformance.checks import Check
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import broken, run_checks, subjects
from rlbench.checks.result import Finding, Verdict

MARKS = {
    Verdict.HOLDS: "[green]✓[/green]",
    Verdict.FAILS: "[bold red]✗[/bold red]",
    Verdict.MOOT: "[yellow]-[/yellow]",
}


def check(patterns: Sequence[str], device: torch.device) -> bool:
    """Tell every claim of the methods asked for as it is tried; has none failed?

    With `all`, a family that cannot be loaded has failed. Raises PluginError for an unknown name.
    """
    console = Console()
    failed = broken() if "all" in patterns else {}
    for name, why in failed.items():
        told = f"[bold]{escape(name)}[/bold]\n  {MARKS[Verdict.FAILS]} it can be loaded: "
        console.print(told + escape(why), highlight=False, soft_wrap=True)
    found = subjects(patterns, device)
    unsound = [*failed, *(each.name for each in found if not _tick_list(each, console))]
    told = f"{len(found)} methods were checked"
    console.print(f"{told}; unsound: {', '.join(unsound)}" if unsound else f"{told}, none unsound")
    return not unsound


def _tick_list(subject: MethodUnderTest, console: Console) -> bool:
    console.print(f"[bold]{escape(subject.name)}[/bold]")
    if subject.absent:
        console.print(
            f"  {MARKS[Verdict.MOOT]} {escape(subject.absent)}", highlight=False, soft_wrap=True
        )
        return True
    counts: Counter[Verdict] = Counter()
    for claim, finding in run_checks(subject):
        console.print(_line(claim, finding), highlight=False, soft_wrap=True)
        counts[finding.verdict] += 1
    told = ", ".join(f"{counts[verdict]} {verdict.value}" for verdict in Verdict)
    console.print(f"  {told}", highlight=False)
    return not counts[Verdict.FAILS]


def _line(claim: Check, finding: Finding) -> str:
    told = f"  {MARKS[finding.verdict]} {escape(claim.sentence)}"
    told += f": {escape(finding.found)}" if finding.found else ""
    fails = finding.verdict is Verdict.FAILS
    return told + (f" [bold]-> {escape(claim.remedy)}[/bold]" if fails else "")

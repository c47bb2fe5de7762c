"""The tick list: one line per check on the terminal, printed as results arrive."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import Protocol

from rich.console import Console
from rich.markup import escape

from rlbench.checks.result import CheckResult, Verdict

__all__ = ["OnResults", "print_lines", "print_results"]

MARKS = {
    Verdict.PASSED: "[green]✓[/green]",
    Verdict.WARNING: "[yellow]![/yellow]",
    Verdict.FAILED: "[bold red]✗[/bold red]",
    Verdict.SKIPPED: "[dim]-[/dim]",
}


class OnResults(Protocol):
    """What happens to the results of a method, a clip or this machine."""

    def __call__(self, results: Iterable[CheckResult], /, *, title: str = "") -> bool:
        """Show or keep the results as they arrive; returns whether no check failed."""


def print_results(results: Iterable[CheckResult], console: Console, title: str = "") -> bool:
    """Print a tick list and the number of results of each verdict; False if a check failed."""
    counts = print_lines(results, console, title)
    summary = ", ".join(f"{verdict.value}: {counts[verdict]}" for verdict in Verdict)
    console.print(f"  {summary}", highlight=False, soft_wrap=True)
    return not counts[Verdict.FAILED]


def print_lines(
    results: Iterable[CheckResult], console: Console, title: str = ""
) -> Counter[Verdict]:
    """Print a line per result, and count the verdicts.

    A line holds the mark, the check, its figure with both limits, what was found, and after `->`
    how to fix it.
    """
    if title:
        console.print(f"[bold]{escape(title)}[/bold]", highlight=False, soft_wrap=True)
    counts: Counter[Verdict] = Counter()
    for result in results:
        console.print(_format_line(result), highlight=False, soft_wrap=True)
        counts[result.verdict] += 1
    return counts


def _format_line(result: CheckResult) -> str:
    found = result.found
    if not math.isnan(result.limits.good):
        unit = f" {result.limits.unit}" if result.limits.unit else ""
        figure = f"{result.figure:.4g}{unit} ({result.limits})"
        found = f"{figure}, {found}" if found else figure
    found = f": {escape(found)}" if found else ""
    remedy = f" [bold]-> {escape(result.remedy)}[/bold]" if result.remedy else ""
    return f"  {MARKS[result.verdict]} {escape(result.check)}{found}{remedy}"

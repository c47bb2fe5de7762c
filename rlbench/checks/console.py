"""The tick list: one line per check on the terminal, printed as results arrive."""

from __future__ import annotations

import math
import traceback
from collections import Counter
from collections.abc import Iterable

from rich.console import Console
from rich.markup import escape

from rlbench.checks.result import CheckResult, Verdict

ASCII = {"✓": "+", "✗": "x"}  # where the terminal cannot print the marks
MARKS = {
    Verdict.PASSED: "[green]✓[/green]",
    Verdict.WARNING: "[yellow]![/yellow]",
    Verdict.FAILED: "[bold red]✗[/bold red]",
    Verdict.SKIPPED: "[dim]-[/dim]",
}


def print_results(
    results: Iterable[CheckResult], console: Console, title: str = "", debug: bool = False
) -> list[CheckResult]:
    """Print a tick list and the number of results of each verdict; returns the results."""
    printed = print_lines(results, console, title, debug)
    counts = Counter(result.verdict for result in printed)
    summary = ", ".join(f"{verdict.value}: {counts[verdict]}" for verdict in Verdict)
    console.print(f"  {summary}", highlight=False, soft_wrap=True)
    return printed


def print_lines(
    results: Iterable[CheckResult], console: Console, title: str = "", debug: bool = False
) -> list[CheckResult]:
    """Print a line per result, as they arrive; returns the results.

    A line holds the mark, the check, its figure with both limits, what was found, and after `->`
    how to fix it. With `debug`, the traceback of an exception follows its line.
    """
    if title:
        console.print(f"[bold]{escape(title)}[/bold]", highlight=False, soft_wrap=True)
    printed = []
    for result in results:
        line = _format_line(result)
        if not console.encoding.startswith("utf"):
            line = "".join(ASCII.get(c, c) for c in line)
        console.print(line, highlight=False, soft_wrap=True)
        if debug and result.error:
            lines = traceback.format_exception(result.error)
            console.print("".join(lines), markup=False, highlight=False, soft_wrap=True)
        printed.append(result)
    return printed


def _format_line(result: CheckResult) -> str:
    found = result.found
    if not math.isnan(result.limits.good):
        unit = f" {result.limits.unit}" if result.limits.unit else ""
        figure = f"{result.figure:.4g}{unit} ({result.limits})"
        found = f"{figure}, {found}" if found else figure
    found = f": {escape(found)}" if found else ""
    remedy = f" [bold]-> {escape(result.remedy)}[/bold]" if result.remedy else ""
    return f"  {MARKS[result.verdict]} {escape(result.check)}{found}{remedy}"

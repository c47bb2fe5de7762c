"""The verdicts of a stress run on the terminal: a tick list per job, and the counts at the end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from rich.console import Console

from rlbench.checks.console import format_line
from rlbench.checks.result import CheckResult, Verdict
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.tables import VERDICT_NAMES

__all__ = ["count_contained", "count_verdicts", "print_job", "print_summary"]

BAD_PIXEL = "bad-pixel"  # the section that plants one bad pixel per test
PIXELS = "pixels"  # unit of the figure of these tests: the pixels that it changed


def print_job(title: str, results: Iterable[StressResult], console: Console) -> None:
    """Print one line per result: the mark, the test, the figure with its limits, the remedy."""
    console.print(f"[bold]{title}[/bold]", highlight=False, soft_wrap=True)
    for result in results:
        found = ", ".join(filter(None, (_format_figure(result), result.found)))
        line = CheckResult(result.test, result.verdict, found, result.remedy)
        console.print(format_line(line), highlight=False, soft_wrap=True)


def print_summary(results: Sequence[StressResult], console: Console) -> None:
    """Print the number of results of each verdict, and of planted bad pixels that were contained.

    A bad pixel is contained where its test passed.
    """
    console.print(count_verdicts(results), highlight=False, soft_wrap=True)
    planted, contained = count_contained(results)
    if planted:
        text = f"planted bad pixels: {contained} of {planted} contained"
        console.print(text, highlight=False, soft_wrap=True)


def count_verdicts(results: Iterable[StressResult]) -> str:
    """The number of results of each verdict, as text."""
    counts = Counter(result.verdict for result in results)
    return ", ".join(f"{name}: {counts[verdict]}" for verdict, name in VERDICT_NAMES.items())


def count_contained(results: Iterable[StressResult]) -> tuple[int, int]:
    """The number of bad pixels that were planted, and of those that were contained."""
    planted = [
        result.verdict
        for result in results
        if result.section == BAD_PIXEL and result.unit == PIXELS
    ]
    return len(planted), planted.count(Verdict.PASSED)


def _format_figure(result: StressResult) -> str:
    """`2.1 dB (passes up to 1, fails above 3)`, or empty without limits."""
    if math.isnan(result.good):
        return ""
    unit = f" {result.unit}" if result.unit else ""
    return f"{result.figure:.4g}{unit} ({_format_limits(result)})"


def _format_limits(result: StressResult) -> str:
    good, fair = result.good, result.fair
    if good == fair:
        return f"at most {good:g}"
    if math.isnan(fair):
        return f"limit {good:g}"
    words = ("up to", "above") if good < fair else ("from", "below")
    return f"passes {words[0]} {good:g}, fails {words[1]} {fair:g}"

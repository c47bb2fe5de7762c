"""The tick list of a clip, on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from rlbench.checks.finding import Finding, Verdict

if TYPE_CHECKING:
    from rlbench.checks.lint.clip_arrays import ClipArrays

MARKS = {
    Verdict.PASS: "[green]pass[/green]",
    Verdict.WARN: "[yellow]warn[/yellow]",
    Verdict.FAIL: "[bold red]FAIL[/bold red]",
}


def tick_list(footage: ClipArrays, findings: Sequence[Finding], console: Console) -> None:
    """One line a check: verdict, name, what was found, and what would do."""
    header = footage.header
    seen = f"{len(footage)} of {header.frames} frames" if len(footage) < header.frames else ""
    seen = seen or f"{header.frames} frames"
    title = f"{header.name}: {header.width} x {header.height}, {seen}"
    shown = Table(title=escape(title), title_justify="left", show_header=False, box=None)
    for _ in range(3):
        shown.add_column(overflow="fold")
    for each in findings:
        told = escape(each.found)
        if each.remedy:
            told += f"\n[bold]-> {escape(each.remedy)}[/bold]"
        shown.add_row(MARKS[each.verdict], escape(each.check), told)
    console.print(shown)
    counts = [f"{sum(f.verdict is v for f in findings)} {v.value}" for v in Verdict]
    console.print(", ".join(counts), highlight=False)

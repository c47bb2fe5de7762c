"""The progress bar of a rendering."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench.parallel.executor import Executor

SPEED_WINDOW_S = 120  # progress of this period gives the remaining time
PARALLEL_SPEED_WINDOW_S = 3600  # the same if progress arrives in whole frames


@contextmanager
def new_or_given_bar(bar: Progress | None, executor: Executor) -> Iterator[Progress]:
    """The given progress bar, or a new one on standard error."""
    if bar:
        yield bar
        return
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TaskProgressColumn())
    window = SPEED_WINDOW_S if executor.exclusive else PARALLEL_SPEED_WINDOW_S
    with Progress(
        *columns, TimeRemainingColumn(), console=Console(stderr=True), speed_estimate_period=window
    ) as active_bar:
        yield active_bar


def format_duration(seconds: float) -> str:
    """A duration in h, min or s.

    >>> format_duration(240.0)
    '4 min'
    """
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"

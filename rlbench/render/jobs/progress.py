"""The progress bar of a rendering."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench.parallel.executor import Executor
from rlbench.system.progress import LoggedProgress

__all__ = ["new_or_given_bar"]

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
    with LoggedProgress(*columns, TimeRemainingColumn(), speed_estimate_period=window) as new_bar:
        yield new_bar

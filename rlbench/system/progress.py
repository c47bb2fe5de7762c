"""Progress of long commands: a bar on a terminal; in a log, a line every 30 s.

`rich` draws bars on terminals only, so a log or a CI job would see nothing until the end.
"""

from __future__ import annotations

import logging
from threading import Event, Thread
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, Task

LOG_PERIOD_S = 30.0


class LoggedProgress(Progress):
    """A `rich.progress.Progress` on standard error that also serves where nothing can be drawn.

    There it prints a line every `log_period_s` seconds for each unfinished task, such as
    `city: 34 % done, about 3 min left`. Other options are those of `rich.progress.Progress`.
    """

    def __init__(
        self,
        *columns: str | ProgressColumn,
        console: Console | None = None,
        log_period_s: float = LOG_PERIOD_S,
        **options: Any,
    ) -> None:
        """Columns, console and options of the bar; the default console is standard error."""
        console = console or Console(stderr=True, quiet=not is_shown())
        super().__init__(*columns, console=console, **options)
        self._log_period_s, self._stopped = log_period_s, Event()
        self._thread = Thread(target=self._log, daemon=True)

    def start(self) -> None:
        """Show the bar, or begin to write lines."""
        super().start()
        if not (self.console.is_interactive or self.console.is_jupyter or self._thread.ident):
            self._thread.start()

    def stop(self) -> None:
        """Write no more lines, and leave the last state of the bar."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()
        super().stop()

    def print_status(self) -> None:
        """Print a line for each unfinished task."""
        for task in self.tasks:
            if not task.finished:
                self.console.print(_describe(task), markup=False, highlight=False, soft_wrap=True)

    def _log(self) -> None:
        while not self._stopped.wait(self._log_period_s):
            self.print_status()


def is_shown() -> bool:
    """True if progress is shown: not where the logger `rlbench` is above WARNING (`rlbench -q`).

    >>> is_shown()
    True
    """
    return logging.getLogger("rlbench").isEnabledFor(logging.WARNING)


def format_duration(seconds: float) -> str:
    """A duration in h, min or s.

    >>> format_duration(240.0)
    '4 min'
    """
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def _describe(task: Task) -> str:
    """The share done and the time left; rich estimates the time from recent progress."""
    left = task.time_remaining
    known = "time left not known yet" if left is None else f"about {format_duration(left)} left"
    return f"{task.description or 'progress'}: {task.percentage:.0f} % done, {known}"

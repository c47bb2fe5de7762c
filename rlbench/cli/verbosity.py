"""What a command says beside its results: nothing, notes and progress, or each step.

Modules log to `logging.getLogger(__name__)`, and the command line prints it to standard error:
by default warnings, with `--quiet` errors alone, with `--verbose` each step and its time.
"""

from __future__ import annotations

import logging

import typer

LOGGER = logging.getLogger("rlbench")
STEP = "%(asctime)s.%(msecs)03d %(name)s: %(message)s"


class EchoHandler(logging.Handler):
    """Prints notes as they are, and steps with their time and module, to standard error."""

    def __init__(self) -> None:
        """Prepare the format of steps."""
        super().__init__()
        self._steps = logging.Formatter(STEP, "%H:%M:%S")

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record; the stream is today's standard error, which tests replace."""
        is_note = record.levelno >= logging.WARNING
        typer.echo(record.getMessage() if is_note else self._steps.format(record), err=True)


def set_verbosity(verbose: bool, quiet: bool) -> None:
    """Print steps, notes or errors alone, from now on."""
    if verbose and quiet:
        raise typer.BadParameter("--verbose says more and --quiet says less. Omit one")
    LOGGER.handlers = [EchoHandler()]
    LOGGER.propagate = False
    LOGGER.setLevel(logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING)


def note(text: str) -> None:
    """Print a note to standard error, unless the command is quiet."""
    LOGGER.warning("%s", text)

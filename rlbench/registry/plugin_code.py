"""Running code of plugins, which must not end the program: an exit is an error like any other.

Otherwise a plugin that calls `sys.exit(0)` while it is imported would end `rlbench check` without a
word and with exit code 0. Not caught: `os._exit`, exits from native code and crashes, which end the
process with a signal or with the code that they set.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rlbench.errors import RlbenchError


class PluginExitError(RlbenchError, RuntimeError):
    """Code of a plugin that tried to end the program."""


@contextmanager
def exits_as_errors() -> Iterator[None]:
    """Raise PluginExitError where code in this block exits the program or interrupts it.

    That is SystemExit, and a KeyboardInterrupt that the code raises. A Ctrl-C of the user passes
    through.

    >>> with exits_as_errors():
    ...     raise SystemExit(0)
    Traceback (most recent call last):
    rlbench.registry.plugin_code.PluginExitError: plugin code called sys.exit(0)...
    """
    with _interrupts_of_the_user() as interrupts:
        try:
            yield
        except SystemExit as error:
            failure = PluginExitError(
                f"plugin code called sys.exit({error.code!r}). Raise an exception that says what "
                "is wrong instead"
            )
            raise failure.with_traceback(error.__traceback__) from error
        except KeyboardInterrupt as error:
            if interrupts:
                raise
            failure = PluginExitError(
                "plugin code raised KeyboardInterrupt, but nobody pressed Ctrl-C. Raise another "
                "exception instead"
            )
            raise failure.with_traceback(error.__traceback__) from error


@contextmanager
def _interrupts_of_the_user() -> Iterator[list[int]]:
    """The interrupts that arrive as signals in this block, which are handled as before."""
    interrupts: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield interrupts
        return

    def record(number: int, frame: Any) -> None:
        interrupts.append(number)
        handler(number, frame)

    signal.signal(signal.SIGINT, record)
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, handler)

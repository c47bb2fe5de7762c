"""Running code of plugins, which must not end the program: an exit is an error like any other.

Otherwise a plugin that calls `sys.exit(0)` while it is imported would end `rlbench check` without a
word and with exit code 0. Not caught: exits from native code, crashes (both end the process with a
signal or with the code that they set), and exits of threads and processes that the plugin starts.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from rlbench.errors import RlbenchError

__all__ = ["PluginExitError", "exits_as_errors"]


class PluginExitError(RlbenchError, RuntimeError):
    """Code of a plugin that tried to end the program."""


@contextmanager
def exits_as_errors() -> Iterator[None]:
    """Raise PluginExitError where code in this block exits the program or interrupts it.

    That is SystemExit, `os._exit` in this process, and a KeyboardInterrupt that the code raises. A
    Ctrl-C of the user passes through.

    >>> with exits_as_errors():
    ...     raise SystemExit(0)
    Traceback (most recent call last):
    rlbench.registry.plugin_code.PluginExitError: plugin code called sys.exit(0)...
    """
    with _interrupts_of_the_user() as interrupts, _os_exit_as_error():
        try:
            yield
        except SystemExit as error:
            failure = PluginExitError(_message(f"sys.exit({error.code!r})"))
            raise failure.with_traceback(error.__traceback__) from error
        except KeyboardInterrupt as error:
            if interrupts:
                raise
            failure = PluginExitError(
                "plugin code raised KeyboardInterrupt, but nobody pressed Ctrl-C. Raise another "
                "exception instead"
            )
            raise failure.with_traceback(error.__traceback__) from error


def _message(call: str) -> str:
    return f"plugin code called {call}. Raise an exception that says what is wrong instead"


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


@contextmanager
def _os_exit_as_error() -> Iterator[None]:
    """Replace `os._exit` in this block; processes forked in it exit as before."""
    exit_process, process = os._exit, os.getpid()

    def refuse(status: int) -> NoReturn:
        if os.getpid() != process:
            exit_process(status)
        raise PluginExitError(_message(f"os._exit({status})"))

    os._exit = refuse
    try:
        yield
    finally:
        os._exit = exit_process

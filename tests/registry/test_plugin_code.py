"""Plugin code cannot end the program; the user can."""

from __future__ import annotations

import signal
import threading

import pytest

from rlbench.registry import PluginExitError, exits_as_errors


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, as in a foreground job; background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_a_ctrl_c_of_the_user_interrupts_plugin_code():
    with pytest.raises(KeyboardInterrupt), exits_as_errors(), exits_as_errors():
        signal.raise_signal(signal.SIGINT)


def test_the_handler_of_interrupts_is_put_back():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(PluginExitError), exits_as_errors(), exits_as_errors():
        raise SystemExit(0)
    assert signal.getsignal(signal.SIGINT) == before


def test_other_errors_and_values_pass_through():
    with pytest.raises(ZeroDivisionError), exits_as_errors():
        _ = 1 / 0
    with exits_as_errors():
        value = 3
    assert value == 3


def test_plugin_code_may_run_in_a_thread():
    errors = []

    def run() -> None:
        try:
            with exits_as_errors():
                raise SystemExit(0)
        except PluginExitError as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert len(errors) == 1

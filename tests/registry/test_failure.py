"""What is said of an error of a plugin, which can raise what it likes and not end the program."""

from __future__ import annotations

import pickle
import signal
import threading
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.parallel.executor import LOCAL
from rlbench.registry import PluginExitError, exits_as_errors
from rlbench.registry.failure import describe_failure, keep_frames
from tests.cli.conftest import interrupts  # noqa: F401
from tests.conftest import write_plugin

TAKEN = "ZeroDivisionError: division by zero"


def raised_by(file: Path, source: str) -> Exception:
    """The error that a file raises when it is run."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(source)
    work = compile(source, str(file), "exec")
    (outcome,) = LOCAL.map(lambda job, on_progress: exec(work, {}), [None])
    return outcome.error


def test_the_line_is_the_last_one_in_the_folder_and_not_of_a_package_installed_there(tmp_path):
    source = "def f():\n    return 1 / 0\n\nf()\n"
    error = raised_by(tmp_path / "bright.py", source)
    assert describe_failure(error, tmp_path) == f"{TAKEN} (bright.py:2)"
    assert describe_failure(error, tmp_path / "elsewhere") == TAKEN
    installed = raised_by(tmp_path / ".venv" / "lib" / "site-packages" / "lib.py", "1 / 0")
    assert describe_failure(installed, tmp_path) == TAKEN


def test_rlbench_is_not_the_code_of_a_plugin_in_a_clone_of_it():
    with pytest.raises(registry.PluginError) as raised:
        registry.load_family("nobody")
    clone = Path(registry.__file__).parents[2]
    text = describe_failure(raised.value, clone)
    assert "lookup.py" not in text
    assert "(test_failure.py:" in text


def test_the_line_of_a_file_that_does_not_parse_is_the_wrong_one(tmp_path):
    (tmp_path / "bright.py").write_text("x = 1\ndef f(:\n")
    with pytest.raises(registry.PluginError, match=r"invalid syntax \(bright\.py:2\)"):
        registry.use_plugin(tmp_path / "bright.py")


def test_notes_of_one_line_are_said(tmp_path):
    error = raised_by(tmp_path / "bright.py", "1 / 0")
    error.add_note("at 2 spp")
    error.add_note("in a worker:\nTraceback")
    assert describe_failure(error, tmp_path) == f"{TAKEN} (bright.py:1), at 2 spp"


def test_an_error_from_another_process_names_its_line(tmp_path):
    error = raised_by(tmp_path / "bright.py", "1 / 0")
    assert describe_failure(pickle.loads(pickle.dumps(error)), tmp_path) == TAKEN
    keep_frames(error)
    copy = pickle.loads(pickle.dumps(error))
    assert describe_failure(copy, tmp_path) == f"{TAKEN} (bright.py:1)"


@pytest.mark.parametrize("method", ["mine", "nobody", "torn"])
def test_the_reason_of_any_method_can_be_said(tmp_path, method):
    registry.use_plugin(write_plugin(tmp_path / "mine.py", "mine"))
    (tmp_path / "torn.py").write_text("raise SystemExit")
    registry.use_plugin(tmp_path / "torn.py")
    assert registry.failure_reason(method, ValueError("no luck")) == "ValueError: no luck"


@pytest.mark.usefixtures("interrupts")
def test_a_ctrl_c_of_the_user_interrupts_plugin_code():
    with pytest.raises(KeyboardInterrupt), exits_as_errors(), exits_as_errors():
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("interrupts")
def test_an_exit_is_an_error_and_the_handler_of_interrupts_is_put_back():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(PluginExitError), exits_as_errors(), exits_as_errors():
        raise SystemExit(0)
    assert signal.getsignal(signal.SIGINT) == before
    with pytest.raises(ZeroDivisionError), exits_as_errors():
        _ = 1 / 0


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

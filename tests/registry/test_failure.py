"""What is said of an error: its text, and the line of a plugin's code that it came from."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.parallel.executor import LOCAL
from rlbench.registry.failure import describe_failure, keep_frames
from tests.conftest import write_plugin

TAKEN = "ZeroDivisionError: division by zero"


def raised_by(file: Path, source: str) -> Exception:
    """The error that a file raises when it is run."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(source)
    work = compile(source, str(file), "exec")
    (outcome,) = LOCAL.map(lambda job, on_progress: exec(work, {}), [None])
    return outcome.error


def test_the_line_is_the_last_one_in_the_folder(tmp_path):
    source = "def f():\n    return 1 / 0\n\nf()\n"
    error = raised_by(tmp_path / "bright.py", source)
    assert describe_failure(error, tmp_path) == f"{TAKEN} (bright.py:2)"
    assert describe_failure(error, tmp_path / "elsewhere") == TAKEN


def test_a_package_that_is_installed_beside_a_plugin_is_not_its_code(tmp_path):
    error = raised_by(tmp_path / ".venv" / "lib" / "site-packages" / "lib.py", "1 / 0")
    assert describe_failure(error, tmp_path) == TAKEN


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

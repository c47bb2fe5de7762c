"""A plugin that fails costs its own rows, in every command that does one row after another."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_noise, write_plugin

UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"
IMAGE = "return samples.mean * GAIN, None"
SECTION = "transformations"
FAULTS = {  # what replaces a line of the plugin, and the reason in its rows
    "exit at import": ("GAIN = 1.0", "raise SystemExit(3)", "plugin code called sys.exit(3)"),
    "error at import": ("GAIN = 1.0", "import no_such_package", "No module named 'no_such_pack"),
    "error in FAMILY": ('FAMILY = Family(\n    "bad"', "FAMILY = Family(\n    1 / 0", "division"),
    "exit in build": ("return Scaled()", "raise SystemExit(3)", "plugin code called sys.exit(3)"),
    "error in plan": (UNIFORM, "raise KeyError('no luck')", "KeyError: 'no luck'"),
    "exit in denoise": (IMAGE, "raise SystemExit(3)", "plugin code called sys.exit(3)"),
}
COMMANDS = {  # words, and what the output has once the rows of `mean` are done
    "run": (
        ("run", "--clips", "clips", "--spp", 1, "--times", "none", "--out", "r"),
        "│ mean │ 1 │ 1",
    ),
    "check": (("check",), "✓ depend on no pixel beyond the receptive field"),
    "stress": (("stress", "--only", SECTION, "--quick", "--out", "s"), "mean: transformations ✓"),
    "speed": (("speed", "--sizes", 16, "--repeats", 1, "--out", "v"), "v/speed.csv"),
    "images": (("images", "--clips", "clips", "--spp", 1, "--out", "i"), "i/noise-1spp-02.png"),
}


def case(command: str, *fault: str):
    """A parameter set; the command images is that of an app."""
    marks = [pytest.mark.app("view")] if command == "images" else []
    return pytest.param(command, *fault, marks=marks)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with a clip."""
    write_noise(tmp_path / "clips" / "noise")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def break_plugin(file: Path, fault: str) -> tuple[int, str]:
    """Put a fault into a plugin file; returns its line and the reason."""
    line, replacement, reason = FAULTS[fault]
    before, found, after = write_plugin(file, "bad").read_text().partition(line)
    assert found
    file.write_text(before + replacement + after)
    return before.count("\n") + replacement.count("\n") + 1, reason


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        *(case("check", fault) for fault in FAULTS),
        *(case(command, "error at import") for command in COMMANDS if command != "check"),
        *(case(command, "exit in denoise") for command in COMMANDS if command != "check"),
    ],
)
def test_a_fault_costs_the_rows_of_its_plugin_and_all_others_are_done(folder, command, fault):
    number, reason = break_plugin(folder / "bad.py", fault)
    words, done = COMMANDS[command]
    output = rlbench(*words, "-m", "bad,mean", "--plugin", "bad.py", code=1)
    assert done in output
    assert reason in output
    assert f"(bad.py:{number})" in output


@pytest.mark.parametrize("command", map(case, COMMANDS))
def test_a_file_that_is_no_python_is_an_error_at_once(folder, command):
    words, done = COMMANDS[command]
    assert "no plugin file at" in rlbench(*words, "-m", "bad", "--plugin", "bad.py", code=2)
    (folder / "bad.py").write_text("x = 1\ndef build(:")
    output = rlbench(*words, "-m", "bad,mean", "--plugin", "bad.py", code=2)
    assert "bad.py is no Python code: SyntaxError: invalid syntax (bad.py:2)" in output
    assert done not in output

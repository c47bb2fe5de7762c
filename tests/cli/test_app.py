"""The command line as a whole: help, version, errors."""

from __future__ import annotations

import importlib.metadata
import io
import re
import resource

import pytest
from rich.console import Console
from typer.testing import CliRunner

from rlbench.checks.console import print_lines
from rlbench.checks.result import Verdict, failed, passed
from rlbench.cli.app import app
from rlbench.cli.commands import list_commands
from rlbench.cli.doctor import inspect_machine
from tests.cli.runner import python, rlbench
from tests.test_readme import check_command

COMMANDS = list(list_commands())
HELP_SECONDS = 0.5  # of processor time


def help_text(command: str) -> str:
    return CliRunner().invoke(app, [command, "--help-all"]).output


def test_commands_are_listed_in_groups_with_one_line_each_and_fit_on_a_screen():
    short, full = (CliRunner().invoke(app, [word]).output for word in ("--help", "--help-all"))
    lines = re.findall(r"^  ([a-z]+)  +[A-Z].*\.$", full, re.MULTILINE)
    assert lines == COMMANDS
    shown = re.findall(r"^  ([a-z]+)  +[A-Z].*\.$", short, re.MULTILINE)
    assert shown == COMMANDS[: len(shown)]
    assert len(short.splitlines()) <= 50
    assert all(name in short for name in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_is_one_sentence_and_examples_that_parse(command):
    text = help_text(command)
    _, sentence, *_ = text.split("\n\n")
    assert re.fullmatch(r"  [A-Z][^.\n]*\.", sentence)
    lines = re.findall(r"^ +(rlbench .*)$", text.split("Examples:")[1], re.MULTILINE)
    assert any(f"rlbench {command}" in line for line in lines)
    for line in lines:
        check_command(line)


def test_options_are_listed_in_groups():
    output = help_text("run")
    titles = re.findall(r"^(\w+):$", output, re.MULTILINE)
    assert titles == ["Methods", "Clips", "Measurement", "Execution", "Output", "Options"]


def test_help_is_fast_and_imports_nothing_heavy():
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom rlbench.cli.app import app\n"
        "assert 'regress' in CliRunner().invoke(app, ['--help']).output\n"
        "print({'torch', 'mitsuba', 'pandas', 'numpy', 'matplotlib'} & set(sys.modules))"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert python("-c", code) == "set()\n"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert used < 2 * HELP_SECONDS  # twice, for slow and busy machines


HEAVY = ("torch", "mitsuba", "drjit", "pandas", "scipy", "matplotlib", "numpy")
LIGHT = {
    "--help": 0,
    "--version": 0,
    "run --help": 0,
    "list": 0,
    "list --json": 0,
    "run -m uors": 2,
    "images -m uors": 2,
    "train -m uors": 2,
    "crossval -m uors": 2,
}


def test_what_needs_no_computing_imports_nothing_heavy():
    code = f"""
import sys
from typer.testing import CliRunner
from rlbench.cli.app import app
for words, code in {LIGHT}.items():
    result = CliRunner().invoke(app, words.split())
    assert result.exit_code == code, (words, result.output)
    print(words, *[name for name in {HEAVY} if name in sys.modules], sep=": ")
"""
    assert python("-c", code).splitlines() == list(LIGHT)


def test_a_typo_in_a_name_is_answered_with_the_nearest_name(tmp_path):
    out = ("--out", tmp_path / "r")
    assert rlbench("run", "-m", "uors", *out, code=2).endswith("not a method. Did you mean 'ours'?")
    assert "Did you mean 'ours/latent-stateless'?" in rlbench(
        "run", "-m", "ours/latent-statless", *out, code=2
    )
    assert "Did you mean 'mini'?" in rlbench("render", "--preset", "minni", code=2)
    assert "Did you mean 'temple'?" in rlbench("render", "--scenes", "tempel", code=2)
    assert "Did you mean" not in rlbench("run", "-m", "reshade", *out, code=2)


def test_the_version_is_that_of_the_package():
    assert rlbench("--version").strip() == importlib.metadata.version("rlbench")


def test_an_unknown_command_and_an_unknown_option_are_usage_errors():
    assert "No such command 'zz'" in rlbench("zz", code=2)
    assert "See rlbench list methods" in rlbench("methods", code=2)
    output = rlbench("run", "--presets", "mini", code=2)
    assert "Usage: rlbench run" in output.replace("root", "rlbench")
    assert "No such option: --presets" in output


def test_a_defect_keeps_its_traceback(monkeypatch):
    def fail(kind):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("rlbench.benchmark.listing.list_installed", fail)
    result = CliRunner().invoke(app, ["list"])
    assert isinstance(result.exception, ZeroDivisionError)


def test_doctor_reports_the_path_tracer_and_packages():
    output = rlbench("doctor")
    assert "path tracer" in output
    assert "torch" in output


def test_doctor_ticks_nothing_that_is_missing():
    ticked = [each.found for each in inspect_machine() if each.verdict is Verdict.PASSED]
    assert not [found for found in ticked if "not installed" in found or "no device" in found]


def test_marks_are_replaced_where_the_terminal_has_none():
    file = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    results = [passed("a"), failed("b", "found", "remedy")]
    print_lines(results, Console(file=file))
    file.flush()
    assert file.buffer.getvalue() == b"  + a\n  x b: found -> remedy\n"


def test_doctor_reports_a_broken_plugin(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    output = rlbench("doctor", "--plugin", tmp_path / "torn.py")
    assert "torn cannot be imported: ZeroDivisionError" in output

"""The command line as a whole: help, version, errors."""

from __future__ import annotations

import importlib.metadata
import io
import re

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


COMPLETED = {
    "rlbench eva": "evaluate",
    "rlbench check our": "ours",
    "rlbench run -m mean,oidn/tu": "mean,oidn/tuned",
    "rlbench render --preset min": "mini",
    "rlbench run --scenes tem": "temple",
    "rlbench report paret": "pareto",
}
COMPLETION = f"""
import contextlib, io, os, sys
from rlbench.cli.app import app
for line, expected in {COMPLETED}.items():
    last = str(len(line.split()) - 1)
    os.environ |= {{"_RLBENCH_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": last}}
    with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
        app(prog_name="rlbench")
    assert expected in shown.getvalue().split(), (line, shown.getvalue())
print(*[name for name in {HEAVY} if name in sys.modules])
"""


def test_names_are_completed_without_importing_torch():
    assert python("-c", COMPLETION) == "\n"


def test_the_version_is_that_of_the_package():
    assert rlbench("--version").strip() == importlib.metadata.version("rlbench")


def test_a_defect_keeps_its_traceback(monkeypatch):
    def fail(kind):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("rlbench.benchmark.listing.list_installed", fail)
    result = CliRunner().invoke(app, ["list"])
    assert isinstance(result.exception, ZeroDivisionError)


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

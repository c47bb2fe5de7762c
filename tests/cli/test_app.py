"""The command line as a whole: help, version, errors."""

from __future__ import annotations

import importlib.metadata
import re
import resource

import pytest
from typer.testing import CliRunner

from rlbench.cli.app import COMMANDS, app
from tests.cli.runner import python, rlbench
from tests.test_readme import check_command

PIPELINE = [
    *("doctor", "list", "render", "render-scene", "import", "lint", "check", "stress"),
    *("train", "lr-find", "replay", "crossval", "run", "report", "decide", "images", "regress"),
]
HELP_SECONDS = 0.5  # of processor time


def help_text(command: str) -> str:
    return CliRunner().invoke(app, [command, "--help"]).output


def test_commands_are_listed_in_the_order_of_the_pipeline_with_one_line_each():
    output = CliRunner().invoke(app, ["--help"]).output
    lines = output.split("Commands:\n")[1].splitlines()
    assert [line.split()[0] for line in lines] == PIPELINE
    assert all(re.fullmatch(r"  [\w-]+  +[A-Z].*\.", line) for line in lines)
    assert "..." not in output.split("Commands:")[1]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_begins_with_one_sentence(command):
    _, sentence, *_ = help_text(command).split("\n\n")
    assert re.fullmatch(r"  [A-Z][^.\n]*\.", sentence)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_examples_that_parse(command):
    examples = help_text(command).split("Examples:")[1]
    lines = re.findall(r"^ +(rlbench .*)$", examples, re.MULTILINE)
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


def test_the_version_is_that_of_the_package():
    assert rlbench("--version").strip() == importlib.metadata.version("rlbench")


def test_an_unknown_command_and_an_unknown_option_are_usage_errors():
    assert "No such command 'zz'" in rlbench("zz", code=2)
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


def test_doctor_reports_a_broken_plugin(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    output = rlbench("doctor", "--plugin", tmp_path / "torn.py")
    assert "torn cannot be imported: ZeroDivisionError" in output

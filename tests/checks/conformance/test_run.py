"""`rlbench check` prints a tick list per method, and its exit code says whether a check failed."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from rlbench import registry
from rlbench.checks.conformance import CHECKS, MethodUnderTest
from rlbench.cli.app import app
from tests.conftest import install_plugin, write_plugin


def rlbench(*arguments: object, code: int) -> list[str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result.stdout.splitlines()


def test_a_loose_method_gets_one_line_per_check(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits="receptive_field=0")
    lines = rlbench("check", "mine/B1", "--plugin", plugin, code=0)
    assert lines[0] == "mine/B1"
    assert lines[1 : len(CHECKS) + 1] == [f"  ✓ {check.requirement}" for check in CHECKS.values()]
    assert lines[-1] == "1 method checked; none failed"


def test_a_failed_check_is_printed_with_what_was_found_and_how_to_fix_it(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits="inputs=frozenset({'depth'})")
    lines = rlbench("check", "mine", "--plugin", plugin, code=1)
    (line,) = [line for line in lines if "✗" in line]
    assert line == (
        "  ✗ declare exactly the G-buffer inputs that are read: expected the inputs that are read "
        "(none), found depth declared -> declare Traits(inputs=frozenset({...})) with the buffers "
        "that are read"
    )


def test_an_exception_of_a_method_is_printed_with_its_line_and_its_traceback_for_debugging(
    tmp_path,
):
    plugin = write_plugin(tmp_path / "mine.py", "mine", body="return 1 / 0, None")
    words = ("check", "mine", "--plugin", plugin)
    lines = rlbench(*words, code=1)
    (line,) = [line for line in lines if "✗" in line]
    number = plugin.read_text().splitlines().index("        return 1 / 0, None") + 1
    assert f"ZeroDivisionError: division by zero (mine.py:{number})" in line
    assert sum("requires a passed check: run on frames of 77 x 123" in line for line in lines) == 22
    assert not any("Traceback" in line for line in lines)
    registry.clear_plugins()
    text = "\n".join(rlbench(*words, "--debug", code=1))
    assert "Traceback (most recent call last)" in text
    assert "    return 1 / 0, None\n" in text


def test_the_work_ahead_is_announced_on_the_error_stream(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    words = ["check", "mine", "mine/B1", "--plugin", str(plugin)]
    result = CliRunner().invoke(app, words)
    assert result.stderr.startswith(f"2 methods, {len(CHECKS)} checks each: seconds for a method")


UNAVAILABLE = {
    "a_package_of_nobody": {"build": "import a_package_of_nobody"},
    "of nobody": {"traits": "pool='of nobody'"},
    "weather": {"traits": "inputs=frozenset({'weather'})"},
}


@pytest.mark.parametrize("missing", UNAVAILABLE)
def test_a_method_that_cannot_run_on_this_machine_is_skipped(tmp_path, missing):
    plugin = write_plugin(tmp_path / "mine.py", "mine", **UNAVAILABLE[missing])
    name, line, counts, total = rlbench("check", "mine", "--plugin", plugin, code=0)
    assert name == "mine"
    assert line.startswith("  - run on this machine: ")
    assert missing in line
    assert counts == "  passed: 0, warning: 0, failed: 0, skipped: 1"
    assert total == "1 method checked; none failed"


def test_samples_of_the_closed_form_clip_stand_in_for_any_installed_pool(tmp_path, monkeypatch):
    kind = 'from rlbench.pools import PoolKind\nPOOL = PoolKind("chains", "of reservoirs")\n'
    (tmp_path / "chains.py").write_text(kind)
    install_plugin(tmp_path, monkeypatch, "pools", "chains = chains:POOL")
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits="pool='chains'")
    lines = rlbench("check", "mine", "--plugin", plugin, code=0)
    assert "1 method checked; none failed" in lines
    assert not MethodUnderTest("mine").unavailable_reason


def test_a_method_with_a_pilot_pass_conforms(tmp_path):
    traits = (
        "adaptive=True, passes=(0.25, 1.0), discard_pilot=True, min_samples=1, spp_range=(4.0, 8.0)"
    )
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits=traits)
    rlbench("check", "mine", "--plugin", plugin, code=0)


def test_a_family_that_cannot_be_imported_fails(tmp_path, monkeypatch):
    path = "rlbench.checks.conformance.run.select_methods"
    monkeypatch.setattr(path, lambda patterns, device: [MethodUnderTest("torn")])
    (tmp_path / "torn.py").write_text("1 / 0")
    lines = rlbench("check", "all", "--plugin", tmp_path / "torn.py", code=1)
    (line,) = [line for line in lines if "✗" in line]
    assert line.startswith("  ✗ be importable: torn from --plugin torn.py cannot be imported: ")
    assert "ZeroDivisionError: division by zero (torn.py:1) -> correct the line" in line
    assert lines[-1] == "1 method checked; failed: torn"

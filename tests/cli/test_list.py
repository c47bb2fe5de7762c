"""The commands list and check."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import get_args

import pytest
from typer.testing import CliRunner

from rlbench.benchmark.listing import list_installed
from rlbench.cli import list_
from rlbench.cli.app import app
from tests.cli.runner import rlbench
from tests.conftest import install_plugin, write_plugin


def list_json(*words: object) -> dict[str, list[dict[str, object]]]:
    return json.loads(CliRunner().invoke(app, ["list", *map(str, words), "--json"]).output)


def test_every_kind_can_be_listed():
    assert set(get_args(list_.Kind)) == {"all", *list_installed()}


@pytest.mark.parametrize("kind", ["methods", "metrics", "scenes", "reports", "pools", "presets"])
def test_the_table_and_the_json_list_the_same_names(kind):
    output = rlbench("list", kind)
    assert all(row["name"] in output for row in list_json(kind)[kind])


def test_list_says_once_why_rows_cannot_be_recorded():
    rows = [row for row in list_json("methods")["methods"] if row["name"].startswith("oidn-intel")]
    names, (reason,) = [row["name"] for row in rows], {row["eager_reason"] for row in rows}
    output = rlbench("list", "methods")
    assert f"not recordable: {', '.join(names)}: {reason}" in output
    assert output.count(reason) == 1


def test_list_shows_where_the_weights_of_a_method_come_from():
    weights = {row["name"]: row["weights"] for row in list_json("methods")["methods"]}
    names = ("mean", "oidn", "oidn/tuned", "ours/fast")
    expected = ["", "shipped, by Intel", "shipped", "to be trained"]
    assert [weights[name] for name in names] == expected


def test_a_plugin_file_is_listed_with_its_variants(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    methods = list_json("--plugin", plugin)["methods"]
    assert "mine/B1" in [row["name"] for row in methods]


def test_a_broken_plugin_is_listed_with_its_error(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    output = rlbench("list", "methods", "--plugin", tmp_path / "torn.py", code=1)
    assert "torn (from --plugin torn.py) cannot be imported: ZeroDivisionError" in output


def test_an_installed_report_without_its_module_is_listed_as_broken(tmp_path, monkeypatch):
    install_plugin(tmp_path, monkeypatch, "reports", "lost = no_figures:write", "figures")
    output = rlbench("list", "reports", code=1)
    assert "lost (from figures) cannot be imported: no module 'no_figures'" in output


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("raise SystemExit(0)", "plugin code called sys.exit(0)"),
        ("raise KeyboardInterrupt", "plugin code raised KeyboardInterrupt"),
    ],
)
def test_an_installed_plugin_that_exits_is_listed_as_broken(
    tmp_path, monkeypatch, statement, message
):
    (tmp_path / "exits.py").write_text(statement)
    install_plugin(tmp_path, monkeypatch, "methods", "gone = exits:FAMILY")
    assert f"cannot be imported: PluginExitError: {message}" in rlbench("list", "methods", code=1)
    assert message in rlbench("run", "-m", "gone", "--out", tmp_path / "r", code=2)


def test_the_process_of_a_check_ends_with_the_exit_code_of_the_check(tmp_path):
    plugin = write_plugin(tmp_path / "exit.py", "exit", body="raise SystemExit(0)")
    command = "from rlbench.cli.app import app; app()"
    words = [sys.executable, "-c", command, "check", "exit", "--plugin", str(plugin)]
    process = subprocess.run(words, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert "failed: exit" in process.stdout

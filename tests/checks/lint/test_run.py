"""`rlbench lint` prints a tick list per clip and draws a figure."""

from __future__ import annotations

from typer.testing import CliRunner

from rlbench.cli.app import app
from tests.checks.lint.broken_fixtures import FAULTS, store


def test_the_command_passes_and_writes_a_figure(folder, tmp_path):
    words = ["lint", str(folder), "--figure", str(tmp_path / "figure.png"), "--frames", "3"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 0, found.output
    assert "failed: 0" in found.output
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_fails_where_a_check_does(arrays, tmp_path):
    store(FAULTS["the halves are equal"][1](arrays), tmp_path / "clips" / "faulty")
    found = CliRunner().invoke(app, ["lint", str(tmp_path / "clips")])
    assert found.exit_code == 1, found.output
    assert "both halves are the same image" in found.output

"""What docs/training.md shows works as it is shown."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rlbench.benchmark import results
from rlbench.cli.app import app
from rlbench.weights import read_card
from tests.procedural_folder import write_world

PAGE = Path(__file__).parent.parent / "docs" / "training.md"
(SNIPPET,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def rlbench(*words: object) -> str:
    found = CliRunner().invoke(app, [str(word) for word in words])
    assert found.exit_code == 0, found.output
    return found.output


@pytest.fixture
def plugin(tmp_path: Path) -> Path:
    (tmp_path / "blur.py").write_text(SNIPPET)
    return tmp_path / "blur.py"


@pytest.fixture
def worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Three clips in the place of generated scenes, whose rendering takes minutes."""
    made = [write_world(tmp_path / "clips" / f"world-{seed}", seed) for seed in range(3)]
    monkeypatch.setattr("rlbench.render.jobs.render_clips.ensure", lambda *asked, **more: made)
    return made


def test_the_example_is_thirty_lines_of_code():
    body = SNIPPET.removeprefix(f'"""{ast.get_docstring(ast.parse(SNIPPET))}"""')
    assert len([line for line in body.splitlines() if line.strip()]) <= 30


def test_the_example_trains_and_its_weights_beat_the_mean(plugin, worlds, tmp_path):
    words = ("--plugin", plugin, "--frames", 180, "--crop", 32, "--device", "cpu")
    assert "blur" in rlbench("train", "-m", "blur", *words, "--out", tmp_path / "runs")
    weights = tmp_path / "runs" / "blur" / "blur.safetensors"
    assert read_card(weights).frames_seen == 180
    words = ("--plugin", plugin, "--clips", worlds[0], "--out", tmp_path / "r", "--spp", 1)
    rlbench("run", "-m", "blur", *words, "--weights", weights)
    rlbench("run", "-m", "mean", *words)
    rows = results.read(tmp_path / "r")
    psnr = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    assert psnr["blur"] > psnr["mean"] + 1  # dB; the clip validates, so it was not trained on


def test_learning_rates_are_tried_by_one_command(plugin, worlds, tmp_path):
    words = ("--plugin", plugin, "--frames", 30, "--crop", 32, "--device", "cpu", "--range-test")
    found = rlbench("train", "-m", "blur", *words, "--out", tmp_path / "runs")
    assert "proposed" in found
    files = {file.name for file in (tmp_path / "runs" / "blur-range").iterdir()}
    assert files == {"range.csv", "range.png"}


def test_a_training_is_started_anew_by_a_flag(plugin, worlds, tmp_path):
    words = ("--plugin", plugin, "--frames", 3, "--crop", 32, "--device", "cpu")
    words = ("train", "-m", "blur", *words, "--out", tmp_path / "runs", "--budget", "1,2")
    rlbench(*words)
    first = read_card(tmp_path / "runs" / "blur-1+2spp" / "blur.safetensors")
    assert "blur-1+2spp.old-1" in rlbench(*words, "--fresh")
    old = tmp_path / "runs" / "blur-1+2spp.old-1" / "blur.safetensors"
    assert read_card(old) == first
    assert read_card(tmp_path / "runs" / "blur-1+2spp" / "blur.safetensors").sha256 == first.sha256


def test_every_file_that_the_page_links_is_there():
    linked = re.findall(r"\]\((\.\./[\w/.-]+)\)", PAGE.read_text())
    assert linked
    assert [name for name in linked if not (PAGE.parent / name).exists()] == []

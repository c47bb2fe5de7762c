"""The example and the commands in docs/how-to/train-a-method.md work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rlbench.apps.render.jobs import render_clips
from rlbench.benchmark import results
from rlbench.cli.app import app
from rlbench.weights import read_card
from tests.procedural_folder import write_world

PAGE = Path(__file__).parent.parent / "docs" / "how-to" / "train-a-method.md"
(SNIPPET,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def rlbench(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def plugin(tmp_path: Path) -> Path:
    (tmp_path / "blur.py").write_text(SNIPPET)
    return tmp_path / "blur.py"


@pytest.fixture
def worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Three clips in place of generated scenes, whose rendering takes minutes."""
    clips = [write_world(tmp_path / "clips" / f"world-{seed}", seed) for seed in range(3)]
    monkeypatch.setattr(render_clips, "ensure", lambda *_, **__: clips)
    return clips


def test_the_example_trains_and_its_weights_beat_the_mean(plugin, worlds, tmp_path):
    options = ("--plugin", plugin, "--frames", 180, "--crop", 32, "--device", "cpu")
    assert "blur" in rlbench("train", "-m", "blur", *options, "--out", tmp_path / "runs")
    weights = tmp_path / "runs" / "blur" / "blur.safetensors"
    assert read_card(weights).frames_seen == 180
    options = ("--plugin", plugin, "--clips", worlds[0], "--out", tmp_path / "r", "--spp", 1)
    rlbench("run", "-m", "blur", *options, "--weights", weights)
    rlbench("run", "-m", "mean", *options)
    rows = results.read(tmp_path / "r")
    psnr = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    assert psnr["blur"] > psnr["mean"] + 1  # dB; the clip validates, so it was not trained on


@pytest.mark.slow
def test_an_option_restarts_a_run_and_archives_the_old_one(plugin, worlds, tmp_path):
    options = ("--plugin", plugin, "--frames", 3, "--crop", 32, "--device", "cpu")
    command = ("train", "-m", "blur", *options, "--out", tmp_path / "runs", "--train-spp", "1,2")
    rlbench(*command)
    first = read_card(tmp_path / "runs" / "blur-1+2spp" / "blur.safetensors")
    assert "blur-1+2spp.old-1" in rlbench(*command, "--restart")
    archived = tmp_path / "runs" / "blur-1+2spp.old-1" / "blur.safetensors"
    assert read_card(archived) == first
    assert read_card(tmp_path / "runs" / "blur-1+2spp" / "blur.safetensors").sha256 == first.sha256

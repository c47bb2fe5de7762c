"""A training that halts keeps the sequence that halted it, and its last checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from rlbench import registry
from rlbench.cli.app import app
from rlbench.training import checkpoint
from rlbench.training.loop import TrainingConfig, TrainingError, replay, train
from rlbench.weights import read_card
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

FAULT = """loss * (
                1e39 if torch.is_autocast_enabled("cpu") and clip.name == "draw 3" and step else 1
            )"""
PLAN = TrainingConfig(
    frames=18, crop=16, length=3, every=3, half=True
)  # six draws, a checkpoint after each


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    registry.use_plugin(write_learner(tmp_path, FAULT))
    return write_noise(tmp_path / "clips" / "noise", h=24, w=24)


@pytest.fixture
def halted(clip: Path, tmp_path: Path) -> Path:
    """The file of a training that halts at step 1 of draw 3, in half precision alone."""
    with pytest.raises(TrainingError) as raised:
        train("blur", [clip], [clip], tmp_path / "run", PLAN)
    file = tmp_path / "run" / "halted-at-draw-3.safetensors"
    assert "'blur' halted in draw 3 at 2 spp: loss is inf at step 1" in str(raised.value)
    assert f"'rlbench train --replay {file}' takes it again" in str(raised.value)
    return file


def test_a_halted_sequence_halts_again_at_the_same_step(halted):
    found = replay(halted)
    assert found is not None
    assert (found.what, found.value, found.step, found.layers) == ("loss", float("inf"), 1, ())


def test_a_halted_sequence_is_replayed_by_the_command_that_the_error_names(halted):
    words = ["train", "--replay", str(halted), "--device", "cpu"]
    assert "again: loss is inf at step 1 of the sequence" in CliRunner().invoke(app, words).output


def test_a_halted_sequence_holds_its_clip_and_what_it_began_with(halted):
    told, tensors = checkpoint.read(halted)
    assert (told["draw"], told["spp"], told["seed"], len(told["frames"])) == (3, 2.0, 0, 3)
    assert tensors["clip.0.radiance"].shape == (1, 8, 3, 16, 16)
    before = checkpoint.read(halted.parent / "checkpoint.safetensors")[1]
    shared = {name for name in tensors if not name.startswith("clip.")}
    assert "weights.weight" in shared
    assert [name for name in shared if not torch.equal(tensors[name], before[name])] == []


def test_a_training_that_halted_goes_on_by_another_plan(halted, clip, tmp_path):
    gentle = TrainingConfig(frames=18, crop=16, length=3, every=3)
    with pytest.raises(TrainingError, match="--altered"):
        train("blur", [clip], [clip], tmp_path / "run", gentle)
    progress = train("blur", [clip], [clip], tmp_path / "run", gentle, altered=True)
    assert progress.seen == 18
    card = read_card(tmp_path / "run" / "blur.safetensors")
    assert "after 9 frames: half True -> False" in card.note


def test_a_file_without_a_halted_sequence_is_told(halted):
    with pytest.raises(TrainingError, match="holds no halted sequence"):
        replay(halted.parent / "checkpoint.safetensors")

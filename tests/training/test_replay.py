"""A run that stops stores the sequence that stopped it, and keeps its last checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from rlbench import registry
from rlbench.cli.app import app
from rlbench.training import TrainingConfig, TrainingError, checkpoint, replay_sequence, train
from rlbench.weights import read_card
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

FAULT = """loss * (
                1e39
                if torch.is_autocast_enabled("cpu") and clip.name == "sequence 3" and step
                else 1
            )"""
# six sequences, a checkpoint after each
CONFIG = TrainingConfig(frames=18, crop=16, sequence_length=3, eval_interval=3, bf16=True)
OLD_NAMES = {"method": "name", "index": "draw", "lr_factor": "rate", "fraction_done": "done"}


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    registry.use_plugin(write_learner(tmp_path, FAULT))
    return write_noise(tmp_path / "clips" / "noise", h=24, w=24)


@pytest.fixture
def failed(clip: Path, tmp_path: Path) -> Path:
    """The file of a run that fails at step 1 of sequence 3, in bfloat16 only."""
    with pytest.raises(TrainingError) as raised:
        train("blur", [clip], [clip], tmp_path / "run", CONFIG)
    file = tmp_path / "run" / "failed-sequence-3.safetensors"
    message = str(raised.value)
    assert "'blur' stopped in sequence 3 at 2 spp: loss is inf at step 1" in message
    assert f"'rlbench replay {file}' repeats it" in message
    return file


def test_a_failed_sequence_fails_again_at_the_same_step(failed):
    failure = replay_sequence(failed)
    assert failure is not None
    assert failure == ("loss", float("inf"), 1, ())


def test_a_failed_sequence_is_replayed_by_the_command_in_the_error(failed):
    command = ["replay", str(failed), "--device", "cpu"]
    assert "loss is inf at step 1 of the sequence" in CliRunner().invoke(app, command).output


def test_a_failed_sequence_holds_its_clip_and_the_tensors_that_it_started_with(failed):
    metadata, tensors = checkpoint.read(failed)
    assert (metadata["index"], metadata["spp"], len(metadata["frames"])) == (3, 2.0, 3)
    assert TrainingConfig.from_dict(metadata["config"]) == CONFIG
    assert tensors["clip.0.radiance"].shape == (1, 8, 3, 16, 16)
    expected = checkpoint.read(failed.parent / "checkpoint.safetensors")[1]
    shared = {name for name in tensors if not name.startswith("clip.")}
    assert "weights.weight" in shared
    assert [name for name in shared if not torch.equal(tensors[name], expected[name])] == []


def test_a_failed_sequence_stored_with_the_old_names_is_replayed(failed):
    metadata, tensors = checkpoint.read(failed)
    config, failure = metadata.pop("config"), metadata.pop("failure")
    old = {OLD_NAMES.get(key, key): value for key, value in metadata.items()}
    old |= {"norm": config["max_grad_norm"], "average": config["ema_decay"], "seed": 0}
    old |= {"half": config["bf16"], "found": {"what": failure["quantity"]}}
    checkpoint.write(failed, tensors, old)
    failure = replay_sequence(failed)
    assert failure is not None
    assert failure == ("loss", float("inf"), 1, ())  # fails in bfloat16 only, so `half` was read


def test_a_run_that_stopped_resumes_with_another_config(failed, clip, tmp_path):
    float32 = TrainingConfig(frames=18, crop=16, sequence_length=3, eval_interval=3)
    with pytest.raises(TrainingError, match="--allow-config-change"):
        train("blur", [clip], [clip], tmp_path / "run", float32)
    result = train("blur", [clip], [clip], tmp_path / "run", float32, allow_config_change=True)
    assert result.progress.frames_seen == 18
    assert "after 9 frames: bf16 True -> False" in read_card(result.weights).note


def test_a_file_without_a_failed_sequence_is_refused(failed):
    with pytest.raises(TrainingError, match="holds no failed sequence"):
        replay_sequence(failed.parent / "checkpoint.safetensors")

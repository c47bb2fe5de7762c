"""Checkpoints: everything is restored, and files that were changed are refused."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import save_file

from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import Progress, TrainingConfig, TrainingTask, checkpoint
from rlbench.training.checkpoint import CheckpointError
from rlbench.training.train_state import TrainState


def linear_state() -> TrainState:
    """One layer that is trained beside an auxiliary one, from random weights."""
    network, critic = torch.nn.Linear(3, 2), torch.nn.Linear(3, 1)

    def losses(clip: object, spp: float):
        for _ in range(3):
            yield network(torch.ones(1, 3)).sum() + critic(torch.ones(1, 3)).sum()

    task = TrainingTask(
        registry.load_method("mean"), network, losses, (1.0,), 1e-2, auxiliary_network=critic
    )
    return TrainState(task, TrainingConfig(), "cpu")


def test_a_checkpoint_restores_everything(tmp_path):
    clip, file = procedural_clip(0, Size(1, 16, 16), frames=1), tmp_path / "c.safetensors"
    state, restored = linear_state(), linear_state()
    state.train_sequence(clip, 1.0, 1.0, 0.0)
    checkpoint.write(file, state.state_dict(), {"frames_seen": 5})
    metadata, tensors = checkpoint.read(file)
    assert metadata == {"frames_seen": 5}
    restored.load_state_dict(tensors, state.steps)
    for each in (state, restored):
        each.train_sequence(clip, 1.0, 1.0, 0.0)
    assert (state.steps, restored.steps) == (6, 6)
    torch.testing.assert_close(restored.state_dict(), state.state_dict(), rtol=0, atol=0)


@pytest.mark.parametrize("content", [None, b"junk"])
def test_a_file_that_no_training_run_wrote_is_refused(tmp_path, content):
    file = tmp_path / "c.safetensors"
    if content:
        file.write_bytes(content)
    with pytest.raises(CheckpointError, match="is not a file written by a training run"):
        checkpoint.read(file)


def test_a_checkpoint_with_a_flipped_bit_is_refused(tmp_path):
    file = tmp_path / "c.safetensors"
    checkpoint.write(file, {"weight": torch.ones(3), "bias": torch.ones(3).bfloat16()}, {"a": 1})
    assert torch.equal(checkpoint.read(file)[1]["bias"], torch.ones(3).bfloat16())
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"c\.safetensors was changed after it was written"):
        checkpoint.read(file)


@pytest.mark.parametrize("progress", ["3", "[1]", "null", '"x"', "{", "[" * 100_000])
def test_a_checkpoint_whose_progress_is_no_object_is_refused(tmp_path, progress):
    save_file({"weight": torch.ones(3)}, tmp_path / "c.safetensors", {"progress": progress})
    with pytest.raises(CheckpointError, match="is not a file written by a training run"):
        checkpoint.read(tmp_path / "c.safetensors")


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        ({"frames_seen": "many"}, "Expected `int`, got `str`.*frames_seen"),
        ({"config": 3}, "Expected `object`, got `int`.*config"),
        ({"validation_history": [[1]]}, "validation_history"),
        ({"colour": 1}, "unknown fields: colour"),
    ],
)
def test_progress_of_wrong_types_is_refused(stored, message):
    with pytest.raises(CheckpointError, match=f"{message}.*Choose another --out"):
        Progress.from_dict(stored)

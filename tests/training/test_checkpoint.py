"""Checkpoints: everything is restored, and files with the old names of fields are read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import Progress, TrainingConfig, TrainingTask, checkpoint, train
from rlbench.training.batches import Batches
from rlbench.training.checkpoint import CheckpointError
from rlbench.training.train_state import TrainState
from rlbench.weights import digest
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

# written by commit a26c6ed after 12 of 24 frames of `blur` with a critic, with the old names
OLD_CHECKPOINT = Path(__file__).parent / "data" / "old_names.safetensors"
CONFIG = TrainingConfig(24, crop=16, sequence_length=3, eval_interval=6)
CRITIC = "torch.nn.Conv2d(3, 1, 1)"
CRITIC_LOSS = "loss + (auxiliary(result.image) - loss.detach()).square().mean()"
OLD_NAMES = {  # of stored keys, by their present names
    "frames_seen": "seen",
    "sequences": "draws",
    "frames_per_second": "speed",
    "validation_history": "curve",
    "config": "plan",
    "config_changes": "changes",
    "sequence_length": "length",
    "ema_decay": "average",
    "max_grad_norm": "norm",
    "bf16": "half",
    "eval_interval": "every",
}


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


def rename(value: object) -> object:
    """Nested metadata with the old names of its keys."""
    if isinstance(value, dict):
        return {OLD_NAMES.get(key, key): rename(item) for key, item in value.items()}
    return value


def rename_tensors(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Tensors with the old prefixes of their names."""
    prefixes = {"ema": "average", "auxiliary_network": "aside"}
    split = {name: name.partition(".") for name in tensors}
    return {
        f"{prefixes.get(split[name][0], split[name][0])}.{split[name][2]}": tensor
        for name, tensor in tensors.items()
    }


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    registry.use_plugin(write_learner(tmp_path, CRITIC_LOSS, CRITIC))
    return write_noise(tmp_path / "clips" / "noise", h=24, w=24)


def stop_after(sequences: int):
    """A callback that stops a run like a kill."""

    def on_progress(progress: Progress, loss: float) -> None:
        if progress.sequences == sequences:
            raise KeyboardInterrupt

    return on_progress


def test_a_checkpoint_with_old_names_is_resumed_bit_by_bit(clip, tmp_path):
    killed, undisturbed = tmp_path / "killed", tmp_path / "undisturbed"
    with pytest.raises(KeyboardInterrupt):
        train("blur", [clip], [clip], killed, CONFIG, on_progress=stop_after(5))
    file = killed / "checkpoint.safetensors"
    metadata, tensors = checkpoint.read(file)
    checkpoint.write(file, rename_tensors(tensors), rename(metadata))
    assert set(checkpoint.read_metadata(file)) & set(OLD_NAMES) == set()
    train("blur", [clip], [clip], killed, CONFIG)
    train("blur", [clip], [clip], undisturbed, CONFIG)
    assert digest(killed / "blur.safetensors") == digest(undisturbed / "blur.safetensors")
    torch.testing.assert_close(
        load_file(file), load_file(undisturbed / "checkpoint.safetensors"), rtol=0, atol=0
    )


def test_a_checkpoint_of_the_old_code_is_resumed_as_one_with_the_present_names(clip, tmp_path):
    with safe_open(OLD_CHECKPOINT, "pt") as file:
        stored = json.loads(file.metadata()["progress"])
    assert {"seen", "draws", "curve", "plan"} < set(stored)
    # clips may be hashed differently today; all else stays as it was written
    stored["plan"]["data"] = Batches.from_config(
        [clip], CONFIG, registry.load_method("mean").traits, "cpu"
    ).clip_digests()
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        folder.mkdir()
    old_tensors = load_file(OLD_CHECKPOINT)
    assert {"average.weight", "aside.weight"} < set(old_tensors)
    save_file(old_tensors, old / "checkpoint.safetensors", {"progress": json.dumps(stored)})
    metadata, tensors = checkpoint.read(old / "checkpoint.safetensors")
    checkpoint.write(new / "checkpoint.safetensors", tensors, vars(Progress.from_dict(metadata)))
    for folder in (old, new):
        result = train("blur", [clip], [clip], folder, CONFIG)
        assert (result.progress.frames_seen, result.progress.steps) == (24, 24)
        assert [frames for frames, _ in result.progress.validation_history] == [6, 12, 18, 24]
        assert set(checkpoint.read_metadata(folder / "checkpoint.safetensors")) == set(
            vars(Progress())
        )
    torch.testing.assert_close(
        load_file(old / "checkpoint.safetensors"),
        load_file(new / "checkpoint.safetensors"),
        rtol=0,
        atol=0,
    )


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

"""Checkpoints restore everything, progress makes a note, weights state where they started."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from rlbench import registry
from rlbench.cli import console
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import (
    Progress,
    TrainingConfig,
    TrainingError,
    TrainingTask,
    checkpoint,
    train,
)
from rlbench.training.checkpoint import (
    CheckpointError,
    combine_digests,
    describe_changes,
    start_from,
)
from rlbench.training.train_state import TrainState
from rlbench.weights import ModelCard, WeightsError, read_card, save
from tests.learning_plugin import write_learner


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


def test_a_checkpoint_with_a_flipped_bit_is_refused(tmp_path):
    file = tmp_path / "c.safetensors"
    checkpoint.write(file, {"weight": torch.ones(3), "bias": torch.ones(3).bfloat16()}, {"a": 1})
    assert torch.equal(checkpoint.read(file)[1]["bias"], torch.ones(3).bfloat16())
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"c\.safetensors was changed after it was written"):
        checkpoint.read(file)


@pytest.mark.parametrize("progress", [None, b"junk", "3", "[1]", "null", '"x"', "{", "[" * 100_000])
def test_a_file_that_no_training_run_wrote_is_refused(tmp_path, progress):
    file = tmp_path / "c.safetensors"
    if isinstance(progress, bytes):
        file.write_bytes(progress)
    elif progress:
        save_file({"weight": torch.ones(3)}, file, {"progress": progress})
    with pytest.raises(CheckpointError, match="is not a file written by a training run"):
        checkpoint.read(file)


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


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, "loss 0.1235, 0.0 frames/s"),
        (
            {"frames_per_second": 12.34, "validation_history": [(3, 20.0), (6, 21.5)]},
            "loss 0.1235, validation 21.50 dB, 12.3 frames/s",
        ),
        (
            {
                "validation_history": [(3, 22.0)],
                "curves": {"train": [(3, 20.0, 18.0)], "real": [(3, 24.0, 21.0)]},
            },
            "loss 0.1235, validation 22.00 dB (train 20.00, real 24.00), 0.0 frames/s",
        ),
    ],
    ids=["before validation", "one set", "two sets"],
)
def test_the_progress_bar_shows_loss_validation_and_speed(fields, expected):
    assert console.training_status(Progress(**fields), 0.12345) == expected


def test_many_clips_of_a_changed_config_are_counted():
    clips = [f"shot-{number} 0123" for number in range(9)]
    (change,) = describe_changes({"data": clips}, {"data": clips[:1]})
    assert change == f"data 9 clips {combine_digests(clips)} -> ['shot-0 0123']"


@pytest.mark.parametrize(
    ("frames", "history", "expected"),
    [
        (500, [], "stopped at 500 of 3000 frames"),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 24.5)], "rose by 0.50 dB in the last fifth"),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 24.05)], ""),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 23.0)], ""),
        (1000, [(1000, 20.0)], "stopped"),
    ],
)
def test_the_note_says_if_training_was_too_short(frames, history, expected):
    note = Progress(frames_seen=frames, validation_history=history, config={"frames": 3000}).note
    assert expected in note
    assert bool(note) == bool(expected)


@pytest.mark.parametrize(
    ("rises", "trend"),
    [([], ""), ([3.0], ""), ([3.0] + [0.0] * 9, "flat"), ([0.03] * 10, "flat")]
    + [([0.06] * 10, "rising"), ([1.0, 1.0], "rising"), ([1.0, -1.0], "flat")],
)
def test_the_trend_is_that_of_the_last_fifth(rises, trend):
    history = [(1000 * n, sum(rises[:n])) for n in range(1, len(rises) + 1)]
    assert Progress(validation_history=history).trend == trend


def test_a_change_of_the_config_is_noted_with_its_frame():
    config = {"bf16": True, "frames": 9}
    progress = Progress(frames_seen=9, config=config)
    progress.switch_config(changed := {"bf16": False, "frames": 9})
    assert progress.note == "after 9 frames: bf16 True -> False"
    assert progress.config == changed


def networks(width: int = 4) -> nn.Module:
    return nn.ModuleDict({"same": nn.Linear(2, 3), "other": nn.Linear(3, width)})


@pytest.fixture
def stored(tmp_path):
    file = tmp_path / "stored.safetensors"
    module = networks()
    save(module, file, ModelCard(name="blur", frames_seen=9))
    return file, module


def task_of(module: nn.Module) -> TrainingTask:
    return TrainingTask(registry.load_method("mean"), module, lambda clip, spp: iter(()), (1.0,))


def test_tensors_of_equal_name_and_shape_are_taken_and_others_kept(stored, caplog):
    file, module = stored
    started = networks(width=5)
    kept = started["other"].weight.clone()
    task = start_from(task_of(started), file)
    assert torch.equal(started["same"].weight, module["same"].weight.half().float())
    assert torch.equal(started["other"].weight, kept)
    assert task.origin.startswith("blur after 9 frames, ")
    assert task.origin.endswith("(2 of 4 tensors)")
    assert (sorted(task.pretrained), task.frames_before) == (["same.bias", "same.weight"], 9)
    expected = "same.bias, same.weight; initial values: other.bias, other.weight"
    assert caplog.messages[-1].endswith(expected)


def test_weights_without_such_a_tensor_or_without_a_card_are_refused(stored):
    with pytest.raises(TrainingError, match="no tensor of .* has the name and shape"):
        start_from(task_of(nn.Linear(7, 7)), stored[0])
    stored[0].with_suffix(".toml").unlink()
    with pytest.raises(WeightsError, match="is missing"):
        start_from(task_of(networks()), stored[0])


def test_a_run_records_its_start_and_refuses_another(tmp_path, clip_folder):
    registry.use_plugin(write_learner(tmp_path))
    config = TrainingConfig(frames=6, crop=16, sequence_length=3)
    arguments = ("blur", [clip_folder], [clip_folder])
    first = train(*arguments, tmp_path / "first", config).weights
    second = train(*arguments, tmp_path / "second", config, start=first).weights
    card = read_card(second)
    assert card.origin.startswith("blur after 6 frames, ")
    assert (card.frames_before, card.frames_seen, card.frames_trained) == (6, 6, 12)
    third = train(*arguments, tmp_path / "third", config, start=second).weights
    assert read_card(third).frames_trained == 18
    assert train(*arguments, tmp_path / "second", config, start=first).weights == second
    with pytest.raises(TrainingError, match="changed: start blur after 6 frames"):
        train(*arguments, tmp_path / "second", config)


def test_each_cycle_of_the_learning_rate_is_as_long_as_all_before_it():
    config = {"frames": 100, "until_flat": 0.1}
    done = {}
    for cycles, seen in ((0, 50), (1, 100), (1, 150), (2, 250)):
        progress = Progress(frames_seen=seen, config=config, cycles=[(0, 20.0)] * cycles)
        done[cycles, seen] = (progress.frames_goal, progress.cycle_done, progress.fraction_done)
    assert done == {
        (0, 50): (100, 0.5, 0.5),
        (1, 100): (200, 0.0, 0.5),
        (1, 150): (200, 0.5, 0.75),
        (2, 250): (400, 0.25, 0.625),
    }


def test_minutes_to_anneal_take_the_place_of_frames():
    seen = {"frames_seen": 50, "seconds": 30.0}
    by_frames = Progress(**seen, config={"frames": 200})
    by_time = Progress(**seen, config={"frames": 200, "anneal": 2.0})
    assert (by_frames.fraction_done, by_frames.frames_goal) == (0.25, 200)
    assert (by_time.fraction_done, by_time.frames_goal) == (0.25, 200)
    by_time.seconds = 60.0
    assert (by_time.fraction_done, by_time.frames_goal) == (0.5, 100)

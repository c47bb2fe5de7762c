"""Weights that a training starts from: which tensors are taken, and what the card says."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from rlbench import registry
from rlbench.training import TrainingConfig, TrainingError, TrainingTask, train
from rlbench.training.trained_weights import start_from
from rlbench.weights import ModelCard, WeightsError, read_card, save
from tests.learning_plugin import write_learner


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


def test_weights_with_no_such_tensor_are_refused(stored):
    with pytest.raises(TrainingError, match="no tensor of .* has the name and shape"):
        start_from(task_of(nn.Linear(7, 7)), stored[0])


def test_weights_without_a_card_are_refused(stored):
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

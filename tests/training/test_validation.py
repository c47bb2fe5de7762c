"""Validation: which budgets, and averaged weights that are put back."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch

from rlbench import registry
from rlbench.training import validation
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.mark.parametrize(
    ("training_budgets", "requested", "expected"),
    [
        ((1.0, 2.0), (), [1.0, 4.0]),
        ((1.0, 2.0), (0.5, 3.0, 2.0), [0.5, 3.0]),
        ((2.0,), (2.0,), [2.0]),
    ],
)
def test_validation_is_at_1_and_4_spp_or_at_the_ends_of_the_requested_budgets(
    training_budgets, requested, expected
):
    mean = registry.load_method("mean")
    assert validation.validation_budgets(mean, training_budgets, requested) == expected


def test_each_set_has_a_mean_of_its_own_and_one_of_first_frames(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    sets = {
        name: [write_noise(tmp_path / name, h=24, w=24, frames=frames, pool_spp=2)]
        for name, frames in (("short", 1), ("longer", 3))
    }
    task = registry.training_task("blur")
    arguments = (task.method, task.networks, task.networks)
    result = validation.validate(*arguments, sets, [1.0, 4.0], "cpu")  # 4 spp: 2 are stored
    assert result.sets["short"].psnr == result.sets["short"].first_frames
    assert result.sets["longer"].psnr != result.sets["longer"].first_frames
    assert result.psnr == sum(score.psnr for score in result.sets.values()) / 2
    at_two = validation.validate(*arguments, sets, [1.0, 2.0], "cpu")
    assert at_two.sets == result.sets


def test_averaged_weights_are_scored_and_the_networks_keep_theirs(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    task = registry.training_task("blur")
    average = copy.deepcopy(task.networks)
    torch.nn.init.zeros_(average.weight)  # a black image
    before = copy.deepcopy(task.networks.state_dict())
    black = validation.validate(
        task.method, task.networks, average, {"noise": [clip]}, [1.0], "cpu"
    )
    torch.testing.assert_close(task.networks.state_dict(), before, rtol=0, atol=0)
    own = validation.validate(
        task.method, task.networks, task.networks, {"noise": [clip]}, [1.0], "cpu"
    )
    assert black.psnr != own.psnr
    assert black.preview.shape == (3, 24, 48)
    assert torch.equal(black.preview[..., :24], torch.zeros(3, 24, 24))
    black_method = replace(task.method, net=average)
    other = validation.validate(black_method, average, average, {"noise": [clip]}, [1.0], "cpu")
    assert other.psnr == black.psnr

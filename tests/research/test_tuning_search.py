"""The search of a loss and a rate for `oidn/tuned`: its points, and the one that ships."""

from __future__ import annotations

import pytest
import torch

from baselines.oidn.train import training_task
from research import tuning_search
from tests.baselines.test_oidn import CPU, clip


def test_the_loss_and_rate_of_the_shipped_row_are_one_point_of_the_search():
    shipped = training_task("tuned", CPU, 0)
    searched = tuning_search.training_task("pu-4e-5", CPU, 0)
    assert searched.max_lr == shipped.max_lr
    assert next(searched.losses(clip(64, 64), 1.0)) == next(shipped.losses(clip(64, 64), 1.0))


@pytest.mark.parametrize("variant", tuning_search.FAMILY.variants)
def test_every_point_has_the_rate_that_its_name_gives(variant):
    task = tuning_search.training_task(variant, CPU, 0)
    assert task.max_lr == float(variant.partition("-")[2])
    assert torch.isfinite(next(task.losses(clip(64, 64), 1.0)))

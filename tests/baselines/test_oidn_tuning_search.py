"""The search of the fine-tuning of OIDN: its rates and losses."""

from __future__ import annotations

import pytest
import torch

from baselines.oidn.train import training_task as oidn_task
from baselines.oidn.tuning_search import FAMILY, training_task
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size

CPU = torch.device("cpu")
CLIP = procedural_clip(size=Size(1, 64, 64), frames=1)


def test_the_loss_and_rate_of_the_shipped_row_are_one_point_of_the_search() -> None:
    shipped, searched = oidn_task("tuned", CPU, 0), training_task("pu-4e-5", CPU, 0)
    assert searched.max_lr == shipped.max_lr
    assert next(searched.losses(CLIP, 1.0)) == next(shipped.losses(CLIP, 1.0))


@pytest.mark.parametrize("variant", FAMILY.variants)
def test_every_point_has_the_rate_that_its_name_gives(variant: str) -> None:
    task = training_task(variant, CPU, 0)
    assert task.max_lr == float(variant.partition("-")[2])
    assert torch.isfinite(next(task.losses(CLIP, 1.0)))

"""The method keeps the contract, and its network learns."""

from __future__ import annotations

from importlib import import_module

import pytest
import torch

from rlbench import Size, procedural_clip
from rlbench.checks.conformance import CHECKS, MethodUnderTest, run_check

training = import_module("$name.training")
method = MethodUnderTest("$name")  # runs once, for all checks; its weights are random


@pytest.mark.parametrize("check", CHECKS)
def test_the_contract_is_kept(check: str) -> None:
    run_check(method, check).raise_if_failed()


def test_the_loss_falls() -> None:
    clip = procedural_clip(seed=1, size=Size(1, 48, 48), frames=4)
    task = training.training_task("", torch.device("cpu"), seed=0)
    optimizer = torch.optim.Adam(task.networks.parameters(), task.max_lr)
    losses = []
    for _ in range(8):
        for loss in task.losses(clip, 1.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
    assert sum(losses[-4:]) < 0.9 * sum(losses[:4])

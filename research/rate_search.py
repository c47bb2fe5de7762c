"""A plugin with multiples of the learning rates of the rivals, for a search at the batch of a GPU.

Commands:

    rlbench train --plugin research/rate_search.py -m rates/nppd-x2 --batch 4
    rlbench train --queue research/rates.toml --out runs/rates --batch 4    # all of them
"""

from __future__ import annotations

from dataclasses import replace

import torch

from rlbench import registry
from rlbench.family import Family, Variant
from rlbench.method import Method
from rlbench.training.task import TrainingTask

ROWS = ("nppd", "ntas", "imcd", "dasr")
FACTORS = (1, 2, 4, 8)  # on the peak that the row ships with


def build(variant: str, device: torch.device, weights: str | None) -> Method:
    """The row with the weights of a file (its path), or "random" ones."""
    return registry.load_method(variant.partition("-x")[0], device, weights)


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """The row's own task at a multiple of its rate."""
    row, _, factor = variant.partition("-x")
    task: TrainingTask = registry.training_task(row, device, seed)
    return replace(task, max_lr=task.max_lr * int(factor))


FAMILY = Family(
    name="rates",
    title="Learning rates of rivals",
    paper="",
    licence="Apache-2.0",
    variants={
        f"{row}-x{factor}": Variant(
            f"How good is {row} at {factor} times its rate?",
            registry.get_variant(row).traits,
            pretrained=False,
        )
        for row in ROWS
        for factor in FACTORS
    },
    build=f"{__name__}:build",
    train=f"{__name__}:training_task",
)

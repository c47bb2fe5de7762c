"""How the network is trained: its loss, budgets and learning rate."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from rlbench import Clip, unroll
from rlbench.ops import log_forward
from rlbench.training import TrainingTask

from .method import KernelFilter, make_network


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """What `rlbench train` needs of the method."""
    method = KernelFilter(make_network(seed).to(device))

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for result in unroll(method, clip, spp):
            reference = result.frame.reference.mean
            yield (log_forward(result.image) - log_forward(reference)).abs().mean()

    return TrainingTask(method, method.network, losses, spp=(0.5, 1.0, 2.0, 4.0), max_lr=2e-3)

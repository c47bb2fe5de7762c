"""Train OIDN on radiance accumulated by rule, as `ours` is trained: its loss, rate and start."""

from __future__ import annotations

from functools import partial

import torch

from baselines.accumulate import FAMILY
from baselines.accumulate.method import VARIANTS, Accumulate
from baselines.oidn.method import published_network, to_signed_radiance
from baselines.oidn.train import DetachedState, frame_losses, recurrent_task
from rlbench.training.task import TrainingTask


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Intel's network, and the loss of its image after accumulation and blending.

    Loss, learning rate, budgets and start are those of `ours`.
    """
    network, origin = published_network()
    traits = FAMILY.variants[variant].traits
    method = Accumulate(VARIANTS[variant], traits, network.to(device), decode=to_signed_radiance)
    return recurrent_task(method, network, partial(frame_losses, DetachedState(method)), origin)

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
    """Intel's network, of the variant's widths, and the loss of its image after blending.

    Loss, learning rate, budgets and start are those of `ours`.
    """
    config, traits = VARIANTS[variant], FAMILY.variants[variant].traits
    network, origin = published_network(config.widths)
    method = Accumulate(config, traits, network.to(device), decode=to_signed_radiance)
    return recurrent_task(method, network, partial(frame_losses, DetachedState(method)), origin)

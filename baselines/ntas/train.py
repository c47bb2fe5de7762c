"""Train NTAS's networks jointly: a surrogate gradient through the samples reaches the sampler."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn import functional as F

from baselines.imcd.train import image_and_change_losses
from baselines.ntas import FAMILY
from baselines.ntas.method import VARIANTS, Ntas
from baselines.ntas.network import Networks
from baselines.oidn import equal_start
from rlbench.frames import Clip
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.training import BUDGETS_FROM_1_SPP, SurrogateGradient, TrainingTask

CHANGE_WEIGHT = 1.0  # of the error of the change from the previous frame
LR_MULTIPLIERS = {"sampler": 0.2}  # learning rate 1e-4


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """NTAS with seeded weights, and the loss that trains sampler and denoiser together.

    L1 of the image plus L1 of its change from the previous frame, both against the reference and in
    log transfer space, weights 1 and 1. Hasselgren et al. 2020 use the last frames of a sequence;
    here all frames of each `bptt` count. Their transfer function is not known to us. The variant
    `intel` has the task of `baselines.oidn.equal_start`.
    """
    if variant == "intel":
        return equal_start.training_task(FAMILY.variants[variant].traits, device)
    config = VARIANTS[variant]
    networks = Networks(config.denoiser)
    networks.init_weights(seed)
    networks.to(device)
    method = Ntas(networks, config, FAMILY.variants[variant].traits)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        trained = SurrogateGradient(method, iter(clip), spp)
        frames = (
            (log_forward(r.image), log_forward(r.frame.reference.mean), 0.0)
            for r in unroll(trained, clip, spp)
        )
        return image_and_change_losses(frames, F.l1_loss, CHANGE_WEIGHT, config.bptt)

    return TrainingTask(method, networks, losses, BUDGETS_FROM_1_SPP, lr_multipliers=LR_MULTIPLIERS)

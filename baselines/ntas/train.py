"""Train NTAS's networks jointly: a surrogate gradient through the samples reaches the sampler."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn import functional as F

from baselines.ntas import FAMILY
from baselines.ntas.method import VARIANTS, Ntas
from baselines.ntas.network import Networks
from rlbench.frames import Clip
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.training import BUDGETS_FROM_1_SPP, SurrogateGradient, TrainingTask

__all__ = ["training_task"]

LR_MULTIPLIERS = {"sampler": 0.2}  # learning rate 1e-4


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """NTAS with seeded weights, and the loss that trains sampler and denoiser together.

    L1 of the image plus L1 of its change from the previous frame, both against the reference and in
    log transfer space, weights 1 and 1. Hasselgren et al. 2020 use the last frames of a sequence;
    here all frames of each `bptt` count. Their transfer function is not known to us.
    """
    config = VARIANTS[variant]
    networks = Networks(config.denoiser)
    networks.init_weights(seed)
    networks.to(device)
    method = Ntas(networks, config, FAMILY.variants[variant].traits)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        return _losses(method, clip, spp)

    return TrainingTask(method, networks, losses, BUDGETS_FROM_1_SPP, lr_multipliers=LR_MULTIPLIERS)


def _losses(method: Ntas, clip: Clip, spp: float) -> Iterator[Tensor]:
    """One loss for each `bptt` frames, the mean of the frames' losses."""
    trained = SurrogateGradient(method, iter(clip), spp)
    frame_losses: list[Tensor] = []  # since the last yield
    previous: tuple[Tensor, Tensor] | None = None  # image and reference of the previous frame
    for result in unroll(trained, clip, spp):
        image, reference = log_forward(result.image), log_forward(result.frame.reference.mean)
        loss = F.l1_loss(image, reference)
        if previous is not None:
            loss = loss + F.l1_loss(image - previous[0], reference - previous[1])
        frame_losses.append(loss)
        previous = image, reference
        if len(frame_losses) == method.config.bptt:
            yield torch.stack(frame_losses).mean()
            frame_losses, previous = [], (image.detach(), reference)
    if frame_losses:
        yield torch.stack(frame_losses).mean()

"""Training both networks jointly: what was bought gets a gradient that reaches the map."""

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

SHARES = {"sampler": 0.2}  # of the rate: 1e-4


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """NTAS with seeded weights, and the loss that trains sampler and denoiser together.

    L1 of the image plus L1 of its change since the last frame, both against the reference's and
    in log transfer, weights 1 and 1. Hasselgren et al. 2020 take the last frames of a sequence,
    here it is all frames of each `bptt`; their transfer is not known to us.
    """
    config = VARIANTS[variant]
    networks = Networks(config.denoiser)
    networks.draw(seed)
    networks.to(device)
    method = Ntas(networks, config, FAMILY.variants[variant].traits)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        return _losses(method, clip, spp)

    return TrainingTask(method, networks, losses, BUDGETS_FROM_1_SPP, lr_multipliers=SHARES)


def _losses(method: Ntas, clip: Clip, spp: float) -> Iterator[Tensor]:
    taught = SurrogateGradient(method, iter(clip), spp)
    terms: list[Tensor] = []  # of the frames since the last yield
    before: tuple[Tensor, Tensor] | None = None  # image and reference of the last frame
    for shown in unroll(taught, clip, spp):
        image, truth = log_forward(shown.image), log_forward(shown.frame.reference.mean)
        terms.append(F.l1_loss(image, truth))
        if before is not None:
            terms[-1] = terms[-1] + F.l1_loss(image - before[0], truth - before[1])
        before = image, truth
        if len(terms) == method.config.bptt:
            yield torch.stack(terms).mean()
            terms, before = [], (image.detach(), truth)
    if terms:
        yield torch.stack(terms).mean()

"""Training in three stages: the denoiser alone, the map alone, then both together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor, nn

from baselines.dasr import FAMILY
from baselines.dasr.gamma import gamma
from baselines.dasr.losses import relative
from baselines.dasr.method import Dasr
from baselines.dasr.network import Networks
from rlbench.frames import Clip
from rlbench.run import unroll
from rlbench.training import (
    BUDGETS_FROM_1_SPP,
    SampleGradient,
    SurrogateGradient,
    TrainingTask,
    kuznetsov_gradient,
)

SHARES = {"sampler": 0.2}  # of the rate: 1e-4
STAGES = (  # share of the training by which a stage ends, and the networks that learn in it
    (25 / 70, frozenset({"denoiser"})),
    (30 / 70, frozenset({"sampler"})),
    (1.0, frozenset({"denoiser", "sampler"})),
)
TEACH: dict[str, SampleGradient] = {
    "": kuznetsov_gradient,
    "gamma": gamma,  # does the map learn better from a smooth model of the samples?
}


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """DASR with seeded weights, its losses, and its three stages.

    Kuznetsov et al. 2018, as in the training code behind `network.UNet`: 25,000 steps for the
    denoiser alone, 5,000 for the map alone and 40,000 for both, at 4 samples per pixel. Here the
    same shares of the steps that every method gets, at random budgets. The map starts exactly
    uniform, so the denoiser's stage sees uniform samples.
    """
    networks = Networks()
    networks.draw(seed)
    for weight in networks.sampler.last.parameters():
        nn.init.zeros_(weight)
    networks.to(device)
    method = Dasr(networks, FAMILY.variants[variant].traits)
    # what the denoiser says as it is, in log(1 + L), no clamp: what is clamped gets no gradient
    student = replace(method, develop=lambda value: value)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        taught = SurrogateGradient(student, iter(clip), spp, TEACH[variant])
        for shown in unroll(taught, clip, spp):
            yield relative(shown.image, shown.frame.reference.mean.clamp_min(0).log1p())

    def told(done: float) -> None:
        learning = next(names for end, names in STAGES if done < end)
        for name, network in networks.named_children():
            network.requires_grad_(name in learning)

    return TrainingTask(
        method, networks, losses, BUDGETS_FROM_1_SPP, lr_multipliers=SHARES, on_progress=told
    )

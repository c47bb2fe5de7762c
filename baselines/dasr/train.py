"""Train DASR in three stages: the denoiser alone, the sampler alone, then both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor, nn

from baselines.dasr import FAMILY
from baselines.dasr.gamma import redraw_as_gamma
from baselines.dasr.losses import relative_loss
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

__all__ = ["training_task"]

LR_MULTIPLIERS = {"sampler": 0.2}  # learning rate 1e-4
STAGES = (  # end of each stage as a fraction of the training, and the networks that it trains
    (25 / 70, frozenset({"denoiser"})),
    (30 / 70, frozenset({"sampler"})),
    (1.0, frozenset({"denoiser", "sampler"})),
)
SAMPLE_GRADIENTS: dict[str, SampleGradient] = {
    "": kuznetsov_gradient,
    "gamma": redraw_as_gamma,  # does the sampler learn better from a smooth sample model?
}


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """DASR with seeded weights, its loss and its three stages.

    Kuznetsov et al. 2018, as in the training code behind `network.UNet`: 25,000 steps for the
    denoiser, 5,000 for the sampler and 40,000 for both, at 4 samples per pixel. Here the same
    fractions of the steps that every method gets, at random budgets. The sampling map starts
    exactly uniform, so the first stage trains the denoiser on uniform samples.
    """
    networks = Networks()
    networks.init_weights(seed)
    for weight in networks.sampler.last.parameters():
        nn.init.zeros_(weight)
    networks.to(device)
    method = Dasr(networks, FAMILY.variants[variant].traits)
    # compare the raw output, log(1 + L): clamped values would get no gradient
    undecoded = replace(method, decode=lambda log_radiance: log_radiance)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        trained = SurrogateGradient(undecoded, iter(clip), spp, SAMPLE_GRADIENTS[variant])
        for result in unroll(trained, clip, spp):
            yield relative_loss(result.image, result.frame.reference.mean.clamp_min(0).log1p())

    def select_stage(fraction_done: float) -> None:
        trainable = next(names for end, names in STAGES if fraction_done < end)
        for name, network in networks.named_children():
            network.requires_grad_(name in trainable)

    return TrainingTask(
        method,
        networks,
        losses,
        BUDGETS_FROM_1_SPP,
        lr_multipliers=LR_MULTIPLIERS,
        on_progress=select_stage,
    )

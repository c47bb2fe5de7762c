"""A plugin with sizes, states and unrolls of `ours`, for the search of its configuration.

Commands:

    rlbench train --plugin research/lean_search.py -m 'lean-search/*' --bf16
    rlbench run --plugin research/lean_search.py -m 'lean-search/*' ...
    rlbench speed --plugin research/lean_search.py -m 'lean-search/*'

The last one counts multiply-adds per pixel.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from methods.ours import OURS, TRAITS
from methods.ours.method import Ours, build_config
from methods.ours.train import config_task
from rlbench.family import Family, Variant
from rlbench.ops.unet_widths import FAST_WIDTHS
from rlbench.training.task import TrainingTask

BY_RULE = replace(OURS, sampler=())  # the density of the contrast rule alone
UNROLLS = (1, 2, 3, 6)  # frames that gradients flow back through
LATENTS = (0, 4, 8, 16)  # channels

CONFIGS = {
    "lean": OURS,
    "full-sampler": replace(OURS, sampler_stride=1),  # its actions at full resolution
    **{f"bptt-{k}": replace(BY_RULE, latent=8, bptt=k) for k in UNROLLS},
    **{f"latent-{c}": replace(BY_RULE, latent=c, bptt=3) for c in LATENTS},
    # the same length and unroll with and without a latent, from weights that know accumulated light
    "through-0": replace(BY_RULE, bptt=6, denoiser_start="accumulated"),
    "through-8": replace(BY_RULE, latent=8, bptt=6, denoiser_start="accumulated"),
    "through-kernel-5": replace(
        BY_RULE, latent=4, bptt=6, kernel_taps=25, denoiser_start="accumulated"
    ),
    "ours-through": replace(OURS, bptt=6),
    "kernel-3": replace(BY_RULE, latent=4, bptt=3, kernel_taps=9),
    "kernel-5": replace(BY_RULE, latent=4, bptt=3, kernel_taps=25),
    "tuned": replace(BY_RULE, bptt=3, denoiser_start="tuned"),
    "display": replace(BY_RULE, bptt=3, loss="display"),
    "tuned-display": replace(BY_RULE, bptt=3, denoiser_start="tuned", loss="display"),
    "tuned-display-latent": replace(
        BY_RULE, latent=8, bptt=3, denoiser_start="tuned", loss="display"
    ),
    # the sampler of ours by one gradient alone; ours/A1 is that by the surrogate
    "by-rewards": replace(OURS, learner="reinforce"),
    "by-rounding": replace(OURS, learner="stochastic"),
    "fast": replace(BY_RULE, latent=8, bptt=3, denoiser=FAST_WIDTHS),
}


def build(variant: str, device: torch.device, weights: str | None) -> Ours:
    """The method of a configuration, with the weights of a file (its path), or "random" ones."""
    return build_config(CONFIGS[variant], FAMILY, variant, device, weights)


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """The training task of a configuration."""
    return config_task(CONFIGS[variant], FAMILY.variants[variant].traits, device, seed)


FAMILY = Family(
    name="lean-search",
    title="Configurations of ours",
    paper="",
    licence="Apache-2.0",
    variants={name: Variant(f"How good is {name}?", TRAITS, pretrained=False) for name in CONFIGS},
    build=f"{__name__}:build",
    train=f"{__name__}:training_task",
)

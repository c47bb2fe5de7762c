"""Training `ours`: encoder and denoiser by backpropagation, the sampler by its learner.

Command: rlbench train --methods ours
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours import FAMILY
from methods.ours.frame_problem import FrameProblem
from methods.ours.initialization import start
from methods.ours.method import Ours
from methods.ours.networks import Networks
from methods.ours.policy import BlockPolicyGradient, learner
from methods.ours.state import RecurrentState, detached
from methods.ours.variants import BASE, VARIANTS
from rlbench.family import Traits
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.ops.losses import l1_ms_ssim_loss, log_loss
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.training.task import BUDGETS_FROM_1_SPP, TrainingTask

PEAK = 3e-4  # learning rate
SHARES = {"encoder": 0.2, "sampler": 3.0}  # of it; at the full rate the encoder's tanh saturates
TUNING = 4e-5  # the rate where the denoiser starts from weights that are not ours
TUNED = {"encoder": 2.0, "sampler": 6.0, "auxiliary_network": 25.0}  # shares of that one
BUDGETS = (0.05, 0.25, 0.5, *BUDGETS_FROM_1_SPP)  # samples per pixel, one a sequence
EVERY = 2  # frames between steps of the sampler
WEIGHT = 0.1  # of the learner's loss, which the sampler alone hears; matters for clipping only


@dataclass
class ExploringMethod:
    """`ours` while it trains: acts with noise half of the time, and remembers what it was asked."""

    method: Ours
    policy: BlockPolicyGradient
    generator: torch.Generator
    noisy: bool = True  # in this sequence?
    asked: list[tuple[GBuffer, RecurrentState]] = field(default_factory=list)

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> RecurrentState:
        """As the method's."""
        return self.method.start(size)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of the sampler's action, or of one drawn around it."""
        if self.method.networks.sampler is None:
            return self.method.plan(gbuffer, samples, state)
        self.asked = [(gbuffer, detached(state))]
        with torch.no_grad():
            mean = self.method.act(gbuffer, state)
        if self.noisy:
            corner = self.policy.corner(self.generator)
            mean = self.policy.explore(mean, corner, self.generator)
        return self.method.density(mean)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> tuple[Float[Tensor, "n 3 h w"], RecurrentState]:
        """As the method's."""
        return self.method.denoise(gbuffer, samples, state)


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Networks with seeded weights and a uniform sampler, and the losses that train them.

    Raises LibraryError where training starts from Intel's weights and the extra `oidn` is missing.
    """
    config, traits = VARIANTS[variant].training, FAMILY.variants[variant].traits
    networks = Networks(config)
    origin = start(networks, config, seed)
    networks.to(device)
    method = Ours(config, traits, networks)
    learns = learner(config.learner, networks.foreseen)
    aside = learns.network.to(device) if learns.network is not None else None
    explorer = ExploringMethod(method, BlockPolicyGradient(), torch.Generator())

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        explorer.generator.manual_seed(next(iter(clip)).pool.rounding_seeds[0])
        explorer.noisy = bool(torch.randint(2, (), generator=explorer.generator))
        total, frames = torch.zeros((), device=device), 0
        for shown in unroll(explorer, clip, spp):
            loss = l1_ms_ssim_loss(
                log_forward(shown.image), log_forward(shown.frame.reference.mean)
            )
            if config.decibels:  # else few samples, and hard scenes, would count most
                loss = log_loss(loss)
            if networks.sampler is not None and shown.frame.index % EVERY == 0:
                turn = FrameProblem(method, shown.frame, *explorer.asked[-1], spp)
                loss = loss + WEIGHT * learns.loss(turn, explorer.generator)
            total, frames = total + loss, frames + 1
            if frames % config.bptt == 0 or frames == len(clip):
                yield total / config.bptt
                total = torch.zeros_like(total)

    budgets = tuple(spp for spp in BUDGETS if traits.unsupported_reason(spp) is None)
    peak, shares = (PEAK, SHARES) if not origin else (TUNING, TUNED)
    shares = {**shares, "sampler": shares["sampler"] * narrowed(config.sampler)}
    return TrainingTask(
        method, networks, losses, budgets, peak, shares, origin=origin, auxiliary_network=aside
    )


def narrowed(widths: tuple[int, ...]) -> float:
    """What the rate of a sampler that is wider than that of `ours` is multiplied by.

    Steps of Adam move the output of a layer by as much at any width where the rate falls with the
    width (Yang et al. 2021, table 3). At the full rate a sampler 16 times as wide ends as stripes.
    """
    return min(1.0, BASE.sampler[0] / widths[0]) if widths else 1.0

"""Training `ours`: encoder and denoiser by backpropagation, the sampler by policy gradient.

Command: rlbench train --methods ours
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from methods.ours import FAMILY
from methods.ours.method import Memory, Ours
from methods.ours.network import Networks
from methods.ours.start import start
from methods.ours.variants import VARIANTS
from rlbench.family import Traits
from rlbench.frames import Clip, Frame, Size, View
from rlbench.ops.losses import mixed
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.sampling import Samples, buy, nothing
from rlbench.training import Trainer

PEAK = 1e-3  # learning rate
SHARES = {"encoder": 0.2}  # of it; at the full rate the encoder's tanh saturates
BUDGETS = (0.25, 0.5, 1.0, 1.0, 2.0, 2.0, 4.0, 4.0, 6.0)  # samples per pixel, one a sequence


@dataclass(frozen=True)
class Policy:
    """The simplest policy gradient that gives each pixel credit for its own neighbourhood.

    REINFORCE with several draws of the same frame and state, whose mean is the baseline, and a
    price on samples: one more here is one fewer elsewhere, so that the advantage of a pixel is
    -(change of error around it + price * change of its count), the price being the least-squares
    slope of error against count. The paper gives one reward a frame to an APPO learner, whose joint
    ratio over all pixels leaves the clip range after one step.
    """

    spread: float = 0.3  # deviation of the action, whose range is [-1, 1]
    draws: int = 4  # of the same frame and state
    every: int = 4  # frames between updates of the sampler
    reach: int = 9  # pixels: side of the window over which error is credited to a sample
    weight: float = 0.1  # of the policy's loss beside the image's; matters for clipping only

    def explore(
        self, mean: Float[Tensor, "n 1 h w"], generator: torch.Generator
    ) -> Float[Tensor, "n 1 h w"]:
        """An action drawn around the mean."""
        noise = torch.randn(mean.shape, generator=generator).to(mean.device)
        return mean.detach() + self.spread * noise

    def loss(
        self,
        mean: Float[Tensor, "n 1 h w"],
        actions: Float[Tensor, "k n 1 h w"],
        errors: Float[Tensor, "k n 1 h w"],
        counts: Float[Tensor, "k n 1 h w"],
    ) -> Float[Tensor, ""]:
        """Minus the mean over pixels of advantage times log-probability of the drawn actions."""
        worse = errors - errors.mean(0)
        more = counts - counts.mean(0)
        near = F.avg_pool2d(worse.flatten(0, 1), self.reach, 1, self.reach // 2)
        near = near.view_as(worse) * self.reach**2
        price = -(near * more).sum() / more.square().sum().clamp_min(1e-8)
        advantage = -(near + price * more)
        advantage = advantage / advantage.square().mean().sqrt().clamp_min(1e-8)
        likelihood = -0.5 * ((actions - mean) / self.spread).square()
        return -(advantage * likelihood).mean()


@dataclass
class Explorer:
    """`ours` while it trains: acts with noise, and remembers what the sampler was asked."""

    method: Ours
    policy: Policy
    generator: torch.Generator
    asked: list[tuple[View, Memory]] = field(default_factory=list)

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> Memory:
        """As the method's."""
        return self.method.start(size)

    def plan(self, view: View, samples: Samples, state: Memory) -> Float[Tensor, "n 1 h w"]:
        """The density of an action drawn around the sampler's."""
        if self.method.networks.sampler is None:
            return self.method.plan(view, samples, state)
        self.asked = [(view, state)]
        with torch.no_grad():
            mean = self.method.act(view, state)
        return density(self.policy.explore(mean, self.generator))

    def denoise(
        self, view: View, samples: Samples, state: Memory
    ) -> tuple[Float[Tensor, "n 3 h w"], Memory]:
        """As the method's."""
        return self.method.denoise(view, samples, state)


def trainer(variant: str, device: torch.device, seed: int) -> Trainer:
    """Networks with seeded weights and a uniform sampler, and the losses that train them."""
    config = VARIANTS[variant]
    networks = Networks(config)
    start(networks, seed)
    networks.to(device)
    method = Ours(config, FAMILY.variants[variant].traits, networks)
    policy = Policy()
    explorer = Explorer(method, policy, torch.Generator())

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        explorer.generator.manual_seed(next(iter(clip)).pool.keys[0])
        for shown in unroll(explorer, clip, spp):
            loss = mixed(log_forward(shown.image), log_forward(shown.frame.reference.mean))
            if networks.sampler is not None and shown.frame.index % policy.every == 0:
                loss = loss + policy.weight * _sampler_loss(explorer, shown.frame, spp)
            yield loss

    return Trainer(method, networks, losses, BUDGETS, PEAK, SHARES)


def density(action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """How far an action lies above the lowest one; actions beyond [-1, 1] are clamped."""
    return 1 + action.clamp(-1, 1)


def _sampler_loss(explorer: Explorer, frame: Frame, spp: float) -> Tensor:
    """The policy's loss for one frame: several draws from the state that the frame began with."""
    method, policy = explorer.method, explorer.policy
    view, state = explorer.asked[-1]
    truth = log_forward(frame.reference.mean).clamp(0, 1)
    actions, errors, counts = [], [], []
    mean = method.act(view, state)
    with torch.no_grad():
        for _ in range(policy.draws):
            action = policy.explore(mean, explorer.generator)
            samples = buy(frame.pool, nothing(frame.pool), density(action), spp)
            image, _ = method.denoise(view, samples, state)
            error = (log_forward(image).clamp(0, 1) - truth).square().mean(1, keepdim=True)
            actions.append(action)
            errors.append(error)
            counts.append(samples.counts.float())
    return policy.loss(mean, torch.stack(actions), torch.stack(errors), torch.stack(counts))

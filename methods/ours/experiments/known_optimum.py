"""A sampling problem whose best allocation is known, for whoever claims to learn one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from methods.ours import method
from methods.ours.experiments.toy_scenes import PRIOR, STORED, ToyFrame
from methods.ours.policy.interface import Rollout
from rlbench.frames import Frame, GBuffer, Reference, Samples, StoredPool
from rlbench.sampling import allocate_counts
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts


class Mode(Protocol):
    """What is done with each pixel's estimate before it is judged."""

    @property
    def reach(self) -> int:
        """Pixels that a sample is spread to."""

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] The image, from independent estimates of its pixels."""

    def error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] Its expected squared error, exactly; differentiable in real-valued counts."""


@dataclass(frozen=True)
class Direct:
    """Pixels are judged as they are: n samples leave sigma^2 / (n + 1/2)."""

    reach: int = 0

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """The estimate itself."""
        return estimate

    def error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """Variance of n samples and the prior, which is worth half of one."""
        return sigma.square() / (counts + PRIOR)


@dataclass(frozen=True)
class Filter:
    """A fixed 5x5 binomial filter, weighted by counts: a denoiser that couples pixels."""

    reach: int = 2

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """Mean of the surroundings, each pixel with the weight of its samples and its prior."""
        weight = counts + PRIOR
        return _blur(weight * estimate) / _blur(weight)

    def error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """Variance of that mean, and the square of its bias."""
        weight = counts + PRIOR
        total = _blur(weight)
        variance = _blur(weight * sigma.square(), squared=True) / total.square()
        return variance + (_blur(weight * truth) / total - truth).square()


MODES: dict[str, Mode] = {"direct": Direct(), "filter": Filter()}


def density(action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
    """As of `ours/paper`: how far an action lies above the lowest one, here in [0, 1]."""
    return method.density(action, "linear") / 2


@dataclass(frozen=True)
class ToyProblem:
    """One frame of the task, as the situation of a sampler that is to learn."""

    field: ToyFrame
    mode: Mode
    sampler: Callable[[Tensor], Tensor]
    spp: float = 4
    floor: int = 0
    multiplicative: bool = False  # the density is linear in the action

    @property
    def seen(self) -> Float[Tensor, "n 39 h w"]:
        """Normal, albedo, depth, and latent channels in which the deviation is hidden."""
        return self.field.seen

    @property
    def cost(self) -> int:
        """Samples of each image."""
        return round(self.spp * self.field.sigma[0].numel())

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's action."""
        return self.sampler(self.field.seen)

    def relaxed(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Shares of the budget between floor and cap."""
        low = torch.full(action.shape, self.floor)
        return relaxed_counts(density(action), self.spp, low, STORED)

    def buy(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Whole counts at the exact budget; k n images may lie in a row."""
        low = torch.full(action.shape, self.floor)
        keys = self.field.keys * (len(action) // len(self.field.keys))
        return allocate_counts(density(action.detach()), self.cost, low, STORED, keys)

    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Realised errors, from the same stored samples for every action."""
        counts = self.buy(actions.flatten(0, 1)).view(actions.shape)
        sums = F.pad(self.field.stored.cumsum(1), (0, 0, 0, 0, 0, 0, 1, 0))  # n 1+s 1 h w
        total = sums.expand(len(actions), *sums.shape).gather(2, counts.unsqueeze(2)).squeeze(2)
        whole = counts.float()
        errors = [
            (self.show(t, n) - self.field.truth).square() for t, n in zip(total, whole, strict=True)
        ]
        return Rollout(torch.stack(errors), whole)

    def surrogate_loss(self, teach: SampleGradient) -> Float[Tensor, ""]:
        """The image's squared error, of three colours that are taught alike."""
        action, field = self.act(), self.field
        truth, pool = field.truth.expand(-1, 3, -1, -1), self.pool
        frame = Frame(field.index, GBuffer({}), pool, Reference(truth, truth))
        counts = self.buy(action)
        bought = Samples(pool.read(pool.empty(), counts), counts)
        taught = teach(bought, self.relaxed(action), frame)
        total, whole = taught.radiance.sum(1), counts.float()
        images = [self.show(total[:, c : c + 1], whole) for c in range(3)]
        return torch.stack([(image - field.truth).square().mean() for image in images]).mean()

    @property
    def pool(self) -> StoredPool:
        """The stored samples, of three equal colours."""
        return StoredPool(self.field.stored.expand(-1, -1, 3, -1, -1), self.field.keys)

    def show(self, total: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] The image, from the sums of each pixel's samples."""
        estimate = (total + PRIOR * self.field.prior) / (counts + PRIOR)
        return self.mode.image(estimate, counts)

    def expected(self, counts: Tensor) -> Tensor:
        """[n 1 h w] Expected squared error of whole or relaxed counts."""
        return self.mode.error(self.field.sigma, self.field.truth, counts)


def greedy(sigma: Float[Tensor, "n 1 h w"], cost: int, cap: int = STORED) -> Int[Tensor, "n 1 h w"]:
    """The best whole counts of the direct mode: the `cost` largest gains of each image.

    Gains sigma^2 / ((n + 1/2) (n + 3/2)) fall with every sample, so greed is exact.
    """
    n = torch.arange(cap)
    gains = sigma.flatten(1)[:, :, None].square() / ((n + PRIOR) * (n + 1 + PRIOR))
    chosen = gains.flatten(1).topk(cost).indices // cap
    counts = torch.zeros(sigma.shape, dtype=torch.int64).flatten(1)
    return counts.scatter_add(1, chosen, torch.ones_like(chosen)).view(sigma.shape)


def _blur(values: Tensor, squared: bool = False) -> Tensor:
    """Sums over 5x5 pixels with binomial weights, or with their squares; nothing is outside."""
    line = torch.tensor([1.0, 4, 6, 4, 1]) / 16
    line = line.square() if squared else line
    return F.conv2d(values, torch.outer(line, line)[None, None], padding=2)

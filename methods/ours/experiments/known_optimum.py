"""A toy allocation problem with a known optimum, to test sampler learners on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from methods.ours.density import LinearDensity
from methods.ours.experiments.toy_scenes import PRIOR_SAMPLES, STORED_SAMPLES, ToyFrame
from methods.ours.policy.interface import Rollout
from rlbench.frames import Frame, GBuffer, Reference, Samples, StoredPool
from rlbench.sampling import allocate_counts
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts

__all__ = [
    "MODES",
    "Direct",
    "Filter",
    "FixedFilter",
    "Mode",
    "ToyProblem",
    "greedy_counts",
    "toy_density",
]


class Mode(Protocol):
    """Maps independent estimates of the pixels to the image whose error counts."""

    @property
    def reach(self) -> int:
        """Pixels that a sample is spread to, on each side."""

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] The image, from independent estimates of its pixels."""

    def expected_error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] Its exact expected squared error; differentiable in real-valued counts."""


@dataclass(frozen=True)
class Direct:
    """The estimates are the image: n samples leave an error of sigma^2 / (n + 1/2)."""

    reach: int = 0

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """The estimate itself."""
        return estimate

    def expected_error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """Variance of n samples and the prior, which is worth half a sample."""
        return sigma.square() / (counts + PRIOR_SAMPLES)


@dataclass(frozen=True)
class Filter:
    """A fixed 5x5 binomial filter, weighted by counts: a denoiser that couples pixels."""

    reach: int = 2

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """Mean of the neighbourhood; the weight of a pixel is its samples plus its prior."""
        weight = counts + PRIOR_SAMPLES
        return _blur(weight * estimate) / _blur(weight)

    def expected_error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """Variance of that mean plus its squared bias."""
        weight = counts + PRIOR_SAMPLES
        total = _blur(weight)
        variance = _blur(weight * sigma.square(), squared=True) / total.square()
        return variance + (_blur(weight * truth) / total - truth).square()


@dataclass(frozen=True)
class FixedFilter:
    """The same filter without counts: it couples pixels, but its weights are constants."""

    reach: int = 2

    def image(self, estimate: Tensor, counts: Tensor) -> Tensor:
        """Mean of the neighbourhood, in which all pixels weigh the same."""
        return _blur(estimate) / _blur(torch.ones_like(estimate))

    def expected_error(self, sigma: Tensor, truth: Tensor, counts: Tensor) -> Tensor:
        """Variance of that mean plus its squared bias, which no sample changes."""
        variance, total = sigma.square() / (counts + PRIOR_SAMPLES), _blur(torch.ones_like(truth))
        bias = _blur(truth) / total - truth
        return _blur(variance, squared=True) / total.square() + bias.square()


MODES: Mapping[str, Mode] = {"direct": Direct(), "filter": Filter()}


def toy_density(action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
    """The density of `ours/paper`, scaled to [0, 1]: the height above the lowest action."""
    return LinearDensity()(action) / 2


@dataclass(frozen=True)
class ToyProblem:
    """An AllocationProblem (`policy/interface.py`) made of one toy frame and a mode."""

    frame: ToyFrame
    mode: Mode
    sampler: Callable[[Tensor], Tensor]
    spp: float = 4
    min_samples: int = 0
    multiplicative: bool = False  # the density is linear in the action

    @property
    def observation(self) -> Float[Tensor, "n 39 h w"]:
        """Normal, albedo, depth, and latent channels in which the deviation is hidden."""
        return self.frame.observation

    @property
    def total_samples(self) -> int:
        """Samples of each image."""
        return round(self.spp * self.frame.sigma[0].numel())

    @property
    def max_samples(self) -> int:
        """Largest count of a pixel: all its stored samples."""
        return self.frame.stored.shape[1]

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's action."""
        return self.sampler(self.frame.observation)

    def relaxed_counts(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Shares of the budget, within `min_samples` and `max_samples`."""
        low = torch.full(action.shape, self.min_samples)
        return relaxed_counts(toy_density(action), self.spp, low, self.max_samples)

    def draw_counts(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Whole counts at the exact budget, also for k n images one after another."""
        low = torch.full(action.shape, self.min_samples)
        seeds = self.frame.rounding_seeds
        seeds = seeds * (len(action) // len(seeds))
        density = toy_density(action.detach())
        return allocate_counts(density, self.total_samples, low, self.max_samples, seeds)

    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Realised errors, from the same stored samples for every action."""
        counts = self.draw_counts(actions.flatten(0, 1)).view(actions.shape)
        return Rollout(self.evaluate_counts(counts), counts.float())

    def evaluate_counts(self, counts: Int[Tensor, "k n 1 h w"]) -> Float[Tensor, "k n 1 h w"]:
        """Realised errors of whole counts at any cost, from the same stored samples."""
        sums = F.pad(self.frame.stored.cumsum(1), (0, 0, 0, 0, 0, 0, 1, 0))  # n 1+s 1 h w
        total = sums.expand(len(counts), *sums.shape).gather(2, counts.unsqueeze(2)).squeeze(2)
        errors = [
            (self.image(t, n) - self.frame.truth).square()
            for t, n in zip(total, counts.float(), strict=True)
        ]
        return torch.stack(errors)

    def surrogate_loss(self, sample_gradient: SampleGradient) -> Float[Tensor, ""]:
        """The image's squared error; the three colours of the samples are equal."""
        action, toy = self.act(), self.frame
        truth, pool = toy.truth.expand(-1, 3, -1, -1), self.pool
        frame = Frame(toy.index, GBuffer({}), pool, Reference(truth, truth))
        counts = self.draw_counts(action)
        samples = Samples(pool.read(pool.empty(), counts), counts)
        samples = sample_gradient(samples, self.relaxed_counts(action), frame)
        total, real_counts = samples.radiance.sum(1), counts.float()
        images = [self.image(total[:, c : c + 1], real_counts) for c in range(3)]
        return torch.stack([(image - toy.truth).square().mean() for image in images]).mean()

    @property
    def pool(self) -> StoredPool:
        """The stored samples, with three equal colours."""
        return StoredPool(self.frame.stored.expand(-1, -1, 3, -1, -1), self.frame.rounding_seeds)

    def image(self, total: Tensor, counts: Tensor) -> Tensor:
        """[n 1 h w] The image, from the sum of each pixel's samples."""
        estimate = (total + PRIOR_SAMPLES * self.frame.prior) / (counts + PRIOR_SAMPLES)
        return self.mode.image(estimate, counts)

    def expected_error(self, counts: Tensor) -> Tensor:
        """[n 1 h w] Expected squared error of whole or relaxed counts."""
        return self.mode.expected_error(self.frame.sigma, self.frame.truth, counts)


def greedy_counts(
    sigma: Float[Tensor, "n 1 h w"], total_samples: int, max_samples: int = STORED_SAMPLES
) -> Int[Tensor, "n 1 h w"]:
    """The best whole counts in direct mode: the `total_samples` largest gains of each image.

    Gains sigma^2 / ((n + 1/2) (n + 3/2)) fall with every sample, so a greedy choice is exact.

    >>> greedy_counts(torch.tensor([[[[0.5, 1.5, 2.5, 3.5]]]]), 6)
    tensor([[[[0, 1, 2, 3]]]])
    """
    n = torch.arange(max_samples)
    gains = sigma.flatten(1)[:, :, None].square() / ((n + PRIOR_SAMPLES) * (n + 1 + PRIOR_SAMPLES))
    chosen = gains.flatten(1).topk(total_samples).indices // max_samples
    counts = torch.zeros(sigma.shape, dtype=torch.int64).flatten(1)
    return counts.scatter_add(1, chosen, torch.ones_like(chosen)).view(sigma.shape)


def _blur(values: Tensor, squared: bool = False) -> Tensor:
    """Sums over 5x5 pixels with binomial weights, or with their squares; zero outside."""
    line = torch.tensor([1.0, 4, 6, 4, 1], dtype=values.dtype) / 16
    line = line.square() if squared else line
    return F.conv2d(values, torch.outer(line, line)[None, None], padding=2)

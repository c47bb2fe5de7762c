"""A toy allocation problem with a known optimum: drifting discs of known noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from methods.ours.method import linear_density
from methods.ours.policy import Rollout
from rlbench.frames import Frame, GBuffer, Reference, Samples, StoredPool
from rlbench.sampling import allocate_counts
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts

DISCS = 14  # in front of a background, which comes last
LATENT = 32  # channels in place of a recurrent state
CHANNELS = 7 + LATENT  # normal 3, albedo 3, depth 1, latent
EPISODE_FRAMES = 20
STORED_SAMPLES = 8  # per pixel
PRIOR_SAMPLES = 0.5  # samples that the prior estimate of a pixel is worth
MEDIAN_DEVIATION = 0.2  # of a sample; the truth is about 0.7
HIDDEN_VALUES = 6  # mixed into the latent channels
LATENT_NOISE = 0.1  # standard deviation of the latent channels' own noise


@dataclass(frozen=True)
class ToyFrame:
    """One frame of n scenes: the observation, the truth, and stored samples."""

    index: int
    observation: Float[Tensor, "n 39 h w"]
    truth: Float[Tensor, "n 1 h w"]
    sigma: Float[Tensor, "n 1 h w"]  # standard deviation of one sample
    prior: Float[Tensor, "n 1 h w"]  # an estimate of the truth, of variance sigma^2 / PRIOR_SAMPLES
    stored: Float[Tensor, "n s 1 h w"]  # independent samples, log-normal, of mean `truth`
    rounding_seeds: tuple[int, ...]

    def resample(
        self, generator: torch.Generator, stored_samples: int = STORED_SAMPLES
    ) -> ToyFrame:
        """The same frame with new samples, `stored_samples` per pixel."""
        return replace(self, **_draw_noise(self.truth, self.sigma, generator, stored_samples))


def toy_frames(seed: int, n: int = 4, side: int = 48) -> Iterator[ToyFrame]:
    """Endless episodes: `n` new scenes every EPISODE_FRAMES frames, determined by the seed.

    Deviations are exp of a normal value per disc plus a wave, so that the noisiest hundredth of a
    frame has some 20 times the deviation of its calmest. The latent channels are a fixed random
    mixture of its logarithm with the truth and four unrelated waves, through tanh, with noise.
    """
    episode = 0
    while True:
        generator = torch.Generator().manual_seed(seed * 1_000_003 + episode)
        yield from _episode(generator, n, side)
        episode += 1


def _episode(generator: torch.Generator, n: int, side: int) -> Iterator[ToyFrame]:
    def normal_values(*shape: int) -> Tensor:
        return torch.randn((n, *shape), generator=generator)

    centre = torch.rand(n, DISCS, 2, generator=generator) * side
    speed, radius = normal_values(DISCS, 2), side * (0.06 + 0.16 * normal_values(DISCS).abs())
    normal = F.normalize(normal_values(DISCS + 1, 3), dim=-1)
    albedo = 0.7 + 0.1 * normal_values(DISCS + 1, 3)
    depth = torch.linspace(0.1, 1.0, DISCS + 1).expand(n, -1).unsqueeze(-1)
    noisiness = 0.7 * normal_values(DISCS + 1, 1)
    discs = torch.cat((normal, albedo, depth, noisiness), -1)  # n discs 8
    waves = normal_values(HIDDEN_VALUES - 1, 3)
    mixing = torch.randn(LATENT, HIDDEN_VALUES, generator=torch.Generator().manual_seed(7)) / 2
    for index in range(EPISODE_FRAMES):
        surface = _rasterize(discs, centre + index * speed, radius, side)
        wave = _wave(waves, index, side)
        log_sigma = surface[:, 7:] + 0.4 * wave[:, :1]
        truth = surface[:, 3:6].mean(1, keepdim=True).clamp_min(0.3)
        hidden = torch.cat((log_sigma, 3 * (truth - 0.7), wave[:, 1:]), 1)
        latent = torch.tanh(torch.einsum("lk,nkhw->nlhw", mixing, hidden))
        latent = latent + LATENT_NOISE * normal_values(LATENT, side, side)
        sigma = MEDIAN_DEVIATION * log_sigma.exp()
        yield ToyFrame(
            index=index,
            observation=torch.cat((surface[:, :7], latent), 1),
            truth=truth,
            sigma=sigma,
            **_draw_noise(truth, sigma, generator),
        )


def _rasterize(discs: Tensor, at: Tensor, radius: Tensor, side: int) -> Tensor:
    """[n 8 h w] The values of the frontmost disc at each pixel; `at` [n discs 2] are centres."""
    y, x = _pixel_centres(side)
    distance = (x - at[..., 0, None, None]).square() + (y - at[..., 1, None, None]).square()
    covers = distance < radius[..., None, None].square()
    background = torch.ones_like(covers[:, :1])
    front = torch.cat((covers, background), 1).to(torch.uint8).argmax(1).flatten(1)  # first True
    values = discs.gather(1, front.unsqueeze(-1).expand(-1, -1, 8))
    return values.transpose(1, 2).reshape(len(discs), 8, side, side)


def _wave(waves: Tensor, index: int, side: int) -> Tensor:
    """[n waves h w] Sine waves over the image, slowly moving."""
    y, x = _pixel_centres(side)
    phase = waves[..., 0, None, None] * x + waves[..., 1, None, None] * y
    phase = phase * (2 * math.pi / side) + waves[..., 2, None, None] * (3 + 0.2 * index)
    return phase.sin()


def _pixel_centres(side: int) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(torch.arange(side) + 0.5, torch.arange(side) + 0.5, indexing="ij")
    return y, x


def _draw_noise(
    truth: Tensor, sigma: Tensor, generator: torch.Generator, stored_samples: int = STORED_SAMPLES
) -> dict[str, Any]:
    """The random fields of a ToyFrame: prior, stored samples, rounding seeds."""
    n, _, h, w = truth.shape
    log_variance = (1 + (sigma / truth).square()).log().unsqueeze(1)
    prior, stored = (
        torch.randn(shape, generator=generator)
        for shape in ((n, 1, h, w), (n, stored_samples, 1, h, w))
    )
    return {
        "prior": truth + sigma * prior / PRIOR_SAMPLES**0.5,
        "stored": truth.unsqueeze(1) * (log_variance.sqrt() * stored - log_variance / 2).exp(),
        "rounding_seeds": tuple(torch.randint(2**31, (n,), generator=generator).tolist()),
    }


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
    return linear_density(action) / 2


@dataclass(frozen=True)
class ToyProblem:
    """An AllocationProblem (`policy/learner.py`) made of one toy frame and a mode."""

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

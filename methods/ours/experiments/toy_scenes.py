"""Toy scenes with known noise: drifting discs, and the observations of a sampler."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = [
    "CHANNELS",
    "EPISODE_FRAMES",
    "PRIOR_SAMPLES",
    "STORED_SAMPLES",
    "ToyFrame",
    "toy_frames",
]

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
    normal = torch.nn.functional.normalize(normal_values(DISCS + 1, 3), dim=-1)
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

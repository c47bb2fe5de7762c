"""Moving scenes whose noise is known: discs that drift, and what a sampler sees of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

DISCS = 14  # in front of a background, which is the last
LATENT = 32  # channels that stand in for a state
CHANNELS = 7 + LATENT  # normal 3, albedo 3, depth 1, latent
FRAMES = 20  # of an episode
STORED = 8  # samples of a pixel
PRIOR = 0.5  # samples that what is known beforehand is worth
NOISY = 0.2  # median deviation of a sample; the truth is about 0.7
HIDDEN = 6  # values that the latent channels mix
HAZE = 0.1  # deviation of the latent channels' own noise


@dataclass(frozen=True)
class ToyFrame:
    """One frame of n scenes: what is seen, what is true, and what sampling would show."""

    index: int
    seen: Float[Tensor, "n 39 h w"]
    truth: Float[Tensor, "n 1 h w"]
    sigma: Float[Tensor, "n 1 h w"]  # deviation of one sample
    prior: Float[Tensor, "n 1 h w"]  # a guess of the truth, of variance sigma^2 / PRIOR
    stored: Float[Tensor, "n s 1 h w"]  # independent samples, log-normal, of mean `truth`
    keys: tuple[int, ...]

    def again(self, generator: torch.Generator) -> ToyFrame:
        """The same frame, sampled anew."""
        return replace(self, **_noise(self.truth, self.sigma, generator))


def scenes(seed: int, n: int = 4, side: int = 48) -> Iterator[ToyFrame]:
    """Episodes without end: `n` new scenes every FRAMES frames, the same from the same seed.

    Deviations are exp of a normal value for each disc plus a wave, so that a frame's noisiest
    hundredth is some 20 times its calmest. The latent channels are a fixed random mixture of its
    logarithm with the truth and four waves that mean nothing, through tanh, with noise.
    """
    episode = 0
    while True:
        generator = torch.Generator().manual_seed(seed * 1_000_003 + episode)
        yield from _episode(generator, n, side)
        episode += 1


def _episode(generator: torch.Generator, n: int, side: int) -> Iterator[ToyFrame]:
    def drawn(*shape: int) -> Tensor:
        return torch.randn((n, *shape), generator=generator)

    centre = torch.rand(n, DISCS, 2, generator=generator) * side
    speed, radius = drawn(DISCS, 2), side * (0.06 + 0.16 * drawn(DISCS).abs())
    normal = torch.nn.functional.normalize(drawn(DISCS + 1, 3), dim=-1)
    albedo = 0.7 + 0.1 * drawn(DISCS + 1, 3)
    depth = torch.linspace(0.1, 1.0, DISCS + 1).expand(n, -1).unsqueeze(-1)
    noisy = 0.7 * drawn(DISCS + 1, 1)
    discs = torch.cat((normal, albedo, depth, noisy), -1)  # n discs 8
    waves = drawn(HIDDEN - 1, 3)
    mixing = torch.randn(LATENT, HIDDEN, generator=torch.Generator().manual_seed(7)) / 2
    y, x = torch.meshgrid(torch.arange(side) + 0.5, torch.arange(side) + 0.5, indexing="ij")
    for index in range(FRAMES):
        at = centre + index * speed  # n discs 2
        near = (x - at[..., 0, None, None]).square() + (y - at[..., 1, None, None]).square()
        covers = near < radius[..., None, None].square()
        last = torch.ones_like(covers[:, :1])
        front = torch.cat((covers, last), 1).to(torch.uint8).argmax(1).flatten(1)  # first True
        shown = discs.gather(1, front.unsqueeze(-1).expand(-1, -1, 8))
        shown = shown.transpose(1, 2).reshape(n, 8, side, side)
        turn = waves[..., 0, None, None] * x + waves[..., 1, None, None] * y
        turn = turn * (2 * math.pi / side) + waves[..., 2, None, None] * (3 + 0.2 * index)
        wave = turn.sin()  # n HIDDEN-1 h w
        log_sigma = shown[:, 7:] + 0.4 * wave[:, :1]
        truth = shown[:, 3:6].mean(1, keepdim=True).clamp_min(0.3)
        hidden = torch.cat((log_sigma, 3 * (truth - 0.7), wave[:, 1:]), 1)
        latent = torch.tanh(torch.einsum("lk,nkhw->nlhw", mixing, hidden))
        latent = latent + HAZE * drawn(LATENT, side, side)
        sigma = NOISY * log_sigma.exp()
        yield ToyFrame(
            index=index,
            seen=torch.cat((shown[:, :7], latent), 1),
            truth=truth,
            sigma=sigma,
            **_noise(truth, sigma, generator),
        )


def _noise(truth: Tensor, sigma: Tensor, generator: torch.Generator) -> dict[str, Any]:
    """What is drawn around the truth: prior, stored samples, keys."""
    n, _, h, w = truth.shape
    spread = (1 + (sigma / truth).square()).log().unsqueeze(1)  # of the logarithm, squared
    prior, stored = (
        torch.randn(shape, generator=generator) for shape in ((n, 1, h, w), (n, STORED, 1, h, w))
    )
    return {
        "prior": truth + sigma * prior / PRIOR**0.5,
        "stored": truth.unsqueeze(1) * (spread.sqrt() * stored - spread / 2).exp(),
        "keys": tuple(torch.randint(2**31, (n,), generator=generator).tolist()),
    }

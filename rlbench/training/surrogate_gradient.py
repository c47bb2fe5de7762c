"""Teaching a sampler by gradient: what was bought gets a slope that reaches the density."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.method import Method

LOWEST = -30.0  # log density below which a pixel is at its floor in any case
BISECTIONS = 32  # of the logarithm of a multiplier, some 30 wide: exact to float32
NONE = 1e-20  # below any density: keeps the share of no pixel from dividing by zero

SampleGradient = Callable[[Samples, Float[Tensor, "n 1 h w"], Frame], Samples]


def kuznetsov_gradient(samples: Samples, due: Float[Tensor, "n 1 h w"], frame: Frame) -> Samples:
    """The same samples, whose mean moves towards the truth as the share that is due grows.

    One sample more would move the mean I of a pixel's s samples towards the truth T, on average
    by (T - I) / s: that is taken as dI/ds, as by Kuznetsov et al. 2018, Deep Adaptive Sampling for
    Low Sample Count Rendering. (T - I) is divided by the count that was bought; s is the share that
    was due before rounding. For a quadratic error the estimate is twice the true derivative.
    Every count is >= 1. The slope is that of the mean alone: it lies in the first slot.
    """
    nought = due - due.detach()  # zero, but with a gradient
    away = (frame.reference.mean - samples.mean).detach()
    away = away.where(away.isfinite(), 0.0)  # what a broken sample says is nothing
    first = samples.radiance[:, 0] + nought * away
    return replace(samples, radiance=torch.cat((first[:, None], samples.radiance[:, 1:]), 1))


@dataclass
class SurrogateGradient:
    """A method while it is trained: its samples carry a gradient back to the density it asked for.

    The share of a pixel's samples that was due is differentiated with its normalisation, pixels
    held at a bound get no gradient, and rounding is passed over; `teach` says what samples do as
    that share grows. The truth is the trainer's: with `pull` it is in the gradient alone, and the
    method sees the values that it would see without it.

    Of several passes the last is taught: what it asked for is differentiated, what the earlier ones
    and the pilot bought bounds its shares from below and is part of the mean. The floor is 1 or
    more, and met before the last pass or by it; samples are not `fresh`.
    """

    method: Method
    frames: Iterator[Frame]  # those to come, in order
    spp: float  # budget, samples per pixel
    teach: SampleGradient = kuznetsov_gradient
    density: Tensor | None = None  # what was last asked for
    held: Tensor | None = None  # counts at that time

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> Any:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: Any) -> Float[Tensor, "n 1 h w"]:
        """As the method's; remembered, with its graph, until the samples are here."""
        self.held = samples.counts
        self.density = self.method.plan(gbuffer, samples, state)
        return self.density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: Any
    ) -> tuple[Float[Tensor, "n 3 h w"], Any]:
        """As the method's, on samples with a gradient to the density."""
        assert self.density is not None, "denoise before plan"
        assert self.held is not None, "denoise before plan"
        stored, cap = samples.radiance.shape[1], self.traits.max_samples
        low = self.held.clamp_min(self.traits.min_samples)
        due = relaxed_counts(
            self.density, self.spp, low, stored if cap is None else min(cap, stored)
        )
        return self.method.denoise(gbuffer, self.teach(samples, due, next(self.frames)), state)


def relaxed_counts(
    density: Float[Tensor, "n 1 h w"], spp: float, low: Int[Tensor, "n 1 h w"], high: int
) -> Float[Tensor, "n 1 h w"]:
    """clip(k * density, low, high), differentiable, with the k at which its mean is `spp`.

    Pixels strictly within the bounds share, in proportion to density, what the others leave; so k
    is differentiated too. Where `spp` is the mean of `low` there are none, and no gradient.
    Density in [0, 1], 1 where it is largest; below exp(-30) a pixel may be left at `low`.
    """
    least, low = int(low.min()), low.to(density.dtype)
    with torch.no_grad():
        first = least or spp / 1000  # a multiplier at which the mean is at most `spp`
        below = torch.full_like(density[:, :, :1, :1], math.log(first))
        above = below + math.log(high / first) - LOWEST
        for _ in range(BISECTIONS):
            middle = (below + above) / 2
            over = _clip(density, middle, low, high).mean((2, 3), keepdim=True) > spp
            below, above = torch.where(over, below, middle), torch.where(over, middle, above)
        held = _clip(density, below, low, high)
        free = (held > low) & (held < high)
        left = (held * free).sum((2, 3), keepdim=True)
    wanted = density * free
    scale = left / wanted.sum((2, 3), keepdim=True).clamp_min(NONE)
    return torch.where(free, wanted * scale, held)


def _clip(density: Tensor, log_k: Tensor, low: Tensor, high: int) -> Tensor:
    return (density * log_k.exp()).clamp_max(high).maximum(low)

"""Surrogate gradients for samplers: drawn samples get a gradient with respect to the density."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.frames import Frame, GBuffer, Samples
from rlbench.method import Method
from rlbench.wrappers import MethodWrapper

MIN_LOG_DENSITY = -30.0  # a pixel with a lower density has its minimum count in any case
BISECTIONS = 32  # of the logarithm of a multiplier, an interval of about 30: exact to float32
MIN_DENSITY_SUM = 1e-20  # below any density; avoids a division by zero if no pixel is free

# (samples, relaxed counts [n 1 h w], frame) -> the same samples with a gradient to the counts
SampleGradient = Callable[[Samples, Float[Tensor, "n 1 h w"], Frame], Samples]


def kuznetsov_gradient(
    samples: Samples, relaxed: Float[Tensor, "n 1 h w"], frame: Frame
) -> Samples:
    """The same samples, whose mean has a gradient towards the reference as counts grow.

    On average, one sample more moves a pixel's mean I of s samples towards the reference T by
    (T - I) / s; this is used as dI/ds (Kuznetsov et al. 2018, Deep Adaptive Sampling for Low Sample
    Count Rendering). (T - I) is divided by the count that was drawn; s is the `relaxed` count
    [n 1 h w] before rounding. For a quadratic error the estimate is twice the true derivative.
    All counts must be at least 1. Only the mean has this gradient: it is stored in the first slot.
    """
    zero = relaxed - relaxed.detach()  # with a gradient of one
    error = (frame.reference.mean - samples.mean).detach()
    error = error.where(error.isfinite(), 0.0)  # non-finite samples give no gradient
    first = samples.radiance[:, 0] + zero * error
    return replace(samples, radiance=torch.cat((first[:, None], samples.radiance[:, 1:]), 1))


class PlannedDensity(NamedTuple):
    """A density with its graph, and the counts already drawn when it was planned."""

    density: Float[Tensor, "n 1 h w"]
    counts: Int[Tensor, "n 1 h w"]


@dataclass(frozen=True)
class SurrogateGradient(MethodWrapper[Method]):
    """A method whose samples carry a gradient back to the density that it planned.

    Counts are relaxed to real numbers, and differentiated including their normalisation. Pixels at
    a bound get no gradient; rounding is ignored. `sample_gradient` defines how samples change with
    the counts. The reference enters the gradient alone: the values that the method sees do not
    change.

    With several passes, only the last density gets a gradient; the pilot and earlier passes bound
    the counts from below, and are part of the mean. The method's `min_samples` must be at least 1,
    and it must not discard its pilot. Wrap the method once for each clip, in the same order:

        unroll(SurrogateGradient(method, iter(clip), spp), clip, spp)
    """

    frames: Iterator[Frame]  # of the clip that the method is unrolled on
    spp: float  # budget, samples per pixel
    sample_gradient: SampleGradient = kuznetsov_gradient
    _planned: list[PlannedDensity] = field(default_factory=list, init=False)  # of this frame

    def plan(self, gbuffer: GBuffer, samples: Samples, state: Any) -> Float[Tensor, "n 1 h w"]:
        """The method's density, stored with its graph until `denoise`."""
        density = super().plan(gbuffer, samples, state)
        self._planned[:] = [PlannedDensity(density, samples.counts)]
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: Any
    ) -> tuple[Float[Tensor, "n 3 h w"], Any]:
        """The method's image and state, from samples with a gradient to the density."""
        assert self._planned, "denoise before plan"
        (planned,) = self._planned
        stored, cap = samples.radiance.shape[1], self.traits.max_samples
        max_count = stored if cap is None else min(cap, stored)
        min_counts = planned.counts.clamp_min(self.traits.min_samples)
        relaxed = relaxed_counts(planned.density, self.spp, min_counts, max_count)
        samples = self.sample_gradient(samples, relaxed, next(self.frames))
        return super().denoise(gbuffer, samples, state)


def relaxed_counts(
    density: Float[Tensor, "n 1 h w"],
    spp: float,
    min_counts: Int[Tensor, "n 1 h w"],
    max_count: int,
) -> Float[Tensor, "n 1 h w"]:
    """Counts before rounding: clip(k * density, min_counts, max_count) with mean `spp`.

    Differentiable, including the multiplier k: pixels strictly within the bounds share what the
    others leave, in proportion to their density. If the mean of `min_counts` is `spp`, no pixel is
    within the bounds, and there is no gradient; at 0 spp all counts are zero. The density must lie
    in [0, 1] with a maximum of 1; a pixel with a density below exp(-30) may be left at its minimum.

    >>> density = torch.tensor([[[[0.25, 0.5, 1.0, 1.0]]]])
    >>> relaxed_counts(density, 3.0, torch.ones(1, 1, 1, 4, dtype=torch.int64), 8).flatten()
    tensor([1.0909, 2.1818, 4.3636, 4.3636])
    """
    if spp == 0:
        return density * 0
    smallest, low = min_counts.min().double(), min_counts.to(density.dtype)
    with torch.no_grad():
        # a multiplier at which the mean is at most `spp`
        first = torch.where(smallest > 0, smallest, spp / 1000).log()
        below = first.to(density.dtype).expand_as(density[:, :, :1, :1])
        above = below + (math.log(max_count) - first).to(density.dtype) - MIN_LOG_DENSITY
        for _ in range(BISECTIONS):
            middle = (below + above) / 2
            over = _clip(density, middle, low, max_count).mean((2, 3), keepdim=True) > spp
            below, above = torch.where(over, below, middle), torch.where(over, middle, above)
        clipped = _clip(density, below, low, max_count)
        free = (clipped > low) & (clipped < max_count)
        remaining = (clipped * free).sum((2, 3), keepdim=True)
    free_density = density * free
    scale = remaining / free_density.sum((2, 3), keepdim=True).clamp_min(MIN_DENSITY_SUM)
    return torch.where(free, free_density * scale, clipped)


def _clip(density: Tensor, log_k: Tensor, low: Tensor, high: int) -> Tensor:
    return (density * log_k.exp()).clamp_max(high).maximum(low)

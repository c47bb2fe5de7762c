"""A wrapper that reverses the order of the drawn samples of each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper

__all__ = ["ReversedSamples", "reverse_samples"]


@dataclass(frozen=True)
class ReversedSamples(MethodWrapper[Method]):
    """The wrapped method, which receives the samples of each pixel from last to first."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density."""
        return super().plan(gbuffer, reverse_samples(samples), state)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image, and the next state."""
        return super().denoise(gbuffer, reverse_samples(samples), state)


def reverse_samples(samples: Samples) -> Samples:
    """The samples of each pixel from last to first; empty slots stay last.

    >>> radiance = torch.tensor([1.0, 2.0, 0.0]).view(1, 3, 1, 1, 1).expand(1, 3, 3, 1, 1)
    >>> samples = Samples(radiance, counts=torch.full((1, 1, 1, 1), 2))
    >>> reverse_samples(samples).radiance[0, :, 0].flatten().tolist()
    [2.0, 1.0, 0.0]
    """
    slots = torch.arange(samples.radiance.shape[1], device=samples.counts.device)
    slots = slots.view(1, -1, 1, 1, 1)
    sources = torch.where(samples.valid_mask, samples.counts.unsqueeze(1) - 1 - slots, slots)
    return Samples(samples.radiance.gather(1, sources.expand_as(samples.radiance)), samples.counts)

"""Wrappers of stressed methods: other densities, another first state, samples in another order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper


@dataclass(frozen=True)
class RecordDensity(MethodWrapper[Method]):
    """The wrapped method, and the densities that it planned, in order."""

    densities: list[Tensor] = field(default_factory=list)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density, recorded."""
        self.densities.append(super().plan(gbuffer, samples, state))
        return self.densities[-1]


@dataclass(frozen=True)
class ReplayDensity(MethodWrapper[Method]):
    """The wrapped method with recorded densities in place of its own.

    Two runs of a method then draw the same samples, and images differ by computation alone.
    """

    densities: Iterator[Tensor]

    @classmethod
    def of(cls, method: Method, densities: Sequence[Tensor]) -> ReplayDensity:
        """The method with these densities, the first one first."""
        return cls(method, iter(densities))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The next recorded density. The method's own `plan` runs as well, as in a benchmark."""
        super().plan(gbuffer, samples, state)
        return next(self.densities).to(samples.counts.device)


@dataclass(frozen=True)
class PlannedDensity(MethodWrapper[Method]):
    """The wrapped method with a density made from the height and width of the image."""

    make_density: Callable[[int, int], Float[Tensor, "1 1 h w"]]

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The made density; the method plans as well, since it may rely on that."""
        planned = super().plan(gbuffer, samples, state)
        return self.make_density(*planned.shape[-2:]).to(planned.device).expand_as(planned)


@dataclass(frozen=True)
class ResumeRun(MethodWrapper[Method]):
    """A method that starts from a given state, as if it had run the earlier frames."""

    state: State

    def start(self, size: Size) -> State:
        """The given state."""
        return self.state


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

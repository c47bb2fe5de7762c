"""Wrappers that record a method's densities, and replay them, so that sample counts are equal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper

__all__ = ["RecordDensity", "ReplayDensity"]


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

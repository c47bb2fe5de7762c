"""A method made to do things again: with counts written down for it, or from a saved state."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

from torch import Tensor

from rlbench.checks.conformance.recording import RecordingMethod, same
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State


@dataclass(frozen=True)
class Replayed:
    """A method that is given the counts written down for it, whatever it wishes for."""

    method: RecordingMethod
    counts: Sequence[Tensor]  # after each pass

    @property
    def traits(self) -> Traits:
        """The method's, but for adapting: to the counts."""
        return replace(self.method.traits, adaptive=True)

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The counts; what the method wishes for is with what was watched."""
        self.method.plan(gbuffer, samples, state)
        return self.counts[len(self.method.densities) - 1].double()

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """As the method's."""
        return self.method.denoise(gbuffer, samples, state)


@dataclass(frozen=True)
class ReplayFromCopy:
    """A method that is asked everything twice, the second time from a copy of the state."""

    method: Method
    changed: set[str] = field(default_factory=set)  # what came out otherwise the second time

    @property
    def traits(self) -> Traits:
        """The method's."""
        return self.method.traits

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The density that comes of the copy."""
        saved = deepcopy(state)
        first = self.method.plan(gbuffer, samples, state)
        again = self.method.plan(gbuffer, samples, saved)
        self.changed.update(() if same(first, again) else {"density"})
        return again

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The image, and the state after it, that come of the copy."""
        saved = deepcopy(state)
        first, _ = self.method.denoise(gbuffer, samples, state)
        again, after = self.method.denoise(gbuffer, samples, saved)
        self.changed.update(() if same(first, again) else {"image"})
        return again, after

"""Method wrappers that repeat calls: with recorded sample counts, or from a copied state."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

from torch import Tensor

from rlbench.checks.conformance.recording import RecordingMethod
from rlbench.checks.tensors import is_bit_equal
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper


@dataclass(frozen=True)
class ReplayCounts(MethodWrapper[RecordingMethod]):
    """The wrapped method, given recorded sample counts instead of those that it plans."""

    counts: Sequence[Tensor]  # after each pass

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits, made adaptive, because the counts vary between pixels."""
        return replace(self.method.traits, adaptive=True)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The recorded counts as a density; the wrapped method's own density is recorded."""
        super().plan(gbuffer, samples, state)
        return self.counts[len(self.method.densities) - 1].double()


@dataclass(frozen=True)
class ReplayFromCopy(MethodWrapper[Method]):
    """The wrapped method, called twice per step, the second time with a copy of the state."""

    changed: set[str] = field(default_factory=set)  # results that differed the second time

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The density computed from the copied state."""
        copied = deepcopy(state)
        first = super().plan(gbuffer, samples, state)
        second = super().plan(gbuffer, samples, copied)
        self.changed.update(() if is_bit_equal(first, second) else {"density"})
        return second

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The image and the next state computed from the copied state."""
        copied = deepcopy(state)
        first, _ = super().denoise(gbuffer, samples, state)
        second, next_state = super().denoise(gbuffer, samples, copied)
        self.changed.update(() if is_bit_equal(first, second) else {"image"})
        return second, next_state

"""A method wrapper that records what the method reads, plans and modifies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from rlbench.checks.returns import (
    WrongReturnError,
    find_density_fault,
    find_return_fault,
)
from rlbench.checks.tensors import has_graph, is_bit_equal, iterate_tensors
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper


@dataclass(frozen=True)
class RecordingMethod(MethodWrapper[Method]):
    """The wrapped method, and a record of its behaviour.

    It continues where a benchmark run stops with an error, so that one fault does not hide others:
    an undeclared buffer is provided, and an invalid density is replaced by a uniform one. The
    method receives copies, so that in-place writes have no further effect. What `denoise` returns
    must be an image and a state; anything else raises WrongReturnError.
    """

    buffers_read: set[str] = field(default_factory=set)
    modified: set[str] = field(default_factory=set)  # arguments that the method wrote to
    with_graph: set[str] = field(default_factory=set)  # return values that require gradients
    densities: list[Any] = field(default_factory=list)  # as planned
    counts: list[Tensor] = field(default_factory=list)  # sample counts after each pass

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits, with every buffer as input, so that reads are recorded."""
        return replace(self.method.traits, inputs=frozenset(BUFFER_CHANNELS))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The wrapped method's density, or ones where it is invalid."""
        if len(self.densities) % len(self.method.traits.passes):
            self.counts.append(samples.counts)
        density = self._call(self.method.plan, gbuffer, samples, state)
        self.densities.append(density)
        self.with_graph.update({"density"} if has_graph(density) else ())
        return density if self._is_valid(density, samples) else torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The wrapped method's image and next state."""
        self.counts.append(samples.counts)
        returned = self._call(self.method.denoise, gbuffer, samples, state)
        if fault := find_return_fault(returned, samples.counts.shape[0]):
            raise WrongReturnError(*fault)
        image, state = returned
        parts = (("image", image), ("state", state))
        self.with_graph.update(name for name, value in parts if has_graph(value))
        return image, state

    def _call(
        self, function: Callable[..., Any], gbuffer: GBuffer, samples: Samples, state: State
    ) -> Any:
        """Call `function` with copies and record which arguments it modified."""
        buffers = {name: buffer.clone() for name, buffer in gbuffer.buffers.items()}
        declared = {name: buffers[name] for name in buffers if name in self.method.traits.inputs}
        given = Samples(samples.radiance.clone(), samples.counts.clone())
        state_before = [tensor.clone() for tensor in iterate_tensors(state)]
        recorded = _RecordedBuffers(declared, self.buffers_read)
        result = function(_RecordingGBuffer(recorded, gbuffer.static, buffers), given, state)
        state_after = list(iterate_tensors(state))
        unchanged = {name: is_bit_equal(gbuffer.buffers[name], buffers[name]) for name in buffers}
        unchanged["samples"] = is_bit_equal(samples.radiance, given.radiance) and is_bit_equal(
            samples.counts, given.counts
        )
        unchanged["state"] = len(state_before) == len(state_after) and all(
            map(is_bit_equal, state_before, state_after)
        )
        self.modified.update(name for name in unchanged if not unchanged[name])
        return result

    def _is_valid(self, density: Any, samples: Samples) -> bool:
        """Would a benchmark run accept this density?"""
        if find_density_fault(density, samples.counts.shape):
            return False
        return self.method.traits.adaptive or bool(density.max() == density.min())


@dataclass(frozen=True)
class _RecordingGBuffer(GBuffer):
    """A G-buffer that also provides undeclared buffers; `buffers` records every read."""

    undeclared: Mapping[str, Tensor] = field(default_factory=dict)

    def _read(self, name: str) -> Tensor:
        is_undeclared = name not in self.buffers and name in self.undeclared
        if is_undeclared and isinstance(self.buffers, _RecordedBuffers):
            self.buffers.names_read.add(name)
            return self.undeclared[name]
        return super()._read(name)


@dataclass(frozen=True)
class _RecordedBuffers(Mapping[str, Tensor]):
    """Buffers by name, and the names that were read."""

    buffers: Mapping[str, Tensor]
    names_read: set[str]

    def __getitem__(self, key: str) -> Tensor:
        self.names_read.add(key)
        return self.buffers[key]

    def __contains__(self, key: object) -> bool:
        return key in self.buffers

    def __iter__(self) -> Iterator[str]:
        return iter(self.buffers)

    def __len__(self) -> int:
        return len(self.buffers)

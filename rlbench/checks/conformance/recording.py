"""A method under watch: what it reads, what it wishes for, and what it writes to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor

from rlbench.clips.header import VIEWS
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State


@dataclass(frozen=True)
class RecordingMethod:
    """A method, and what it did.

    It goes on where the bench would stop, so that one fault does not hide all others: a buffer that
    it did not declare is given to it, and a density that cannot be bought is bought as uniform.
    What it is given are copies, so that what it writes to them spoils nothing.
    """

    method: Method
    read: set[str] = field(default_factory=set)  # names of view buffers
    written: set[str] = field(default_factory=set)  # which of its inputs it changed
    graphs: set[str] = field(default_factory=set)  # of what it returned, what holds one
    densities: list[Any] = field(default_factory=list)  # as it wished for them
    counts: list[Tensor] = field(default_factory=list)  # that it saw after each pass

    @property
    def traits(self) -> Traits:
        """The method's, but for needing every buffer, so that those not declared are at hand."""
        return replace(self.method.traits, inputs=frozenset(VIEWS))

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """As the method's, or ones where that cannot be bought."""
        if len(self.densities) % len(self.method.traits.passes):
            self.counts.append(samples.counts)
        density = self._call(self.method.plan, gbuffer, samples, state)
        self.densities.append(density)
        self.graphs.update({"density"} if holds_graph(density) else ())
        return density if self._sold(density, samples) else torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """As the method's."""
        self.counts.append(samples.counts)
        image, state = self._call(self.method.denoise, gbuffer, samples, state)
        held = {name for name, part in (("image", image), ("state", state)) if holds_graph(part)}
        self.graphs.update(held)
        return image, state

    def _call(
        self, asked: Callable[..., Any], gbuffer: GBuffer, samples: Samples, state: State
    ) -> Any:
        """What the method answers; inputs that have another value afterwards are written down."""
        seen = {name: buffer.clone() for name, buffer in gbuffer.buffers.items()}
        declared = {name: seen[name] for name in seen if name in self.method.traits.inputs}
        bought = Samples(samples.radiance.clone(), samples.counts.clone())
        before = [tensor.clone() for tensor in tensors(state)]
        answer = asked(_Watch(_Read(declared, self.read), gbuffer.static, seen), bought, state)
        after = list(tensors(state))
        kept = len(before) == len(after) and all(map(same, before, after))
        kept_samples = same(samples.radiance, bought.radiance)
        kept_samples = kept_samples and same(samples.counts, bought.counts)
        self.written.update(name for name in seen if not same(gbuffer.buffers[name], seen[name]))
        self.written.update({"samples"} if not kept_samples else ())
        self.written.update({"state"} if not kept else ())
        return answer

    def _sold(self, density: Any, samples: Samples) -> bool:
        """Would the bench buy it?"""
        if flaw(density, samples.counts.shape):
            return False
        return self.method.traits.adaptive or bool(density.max() == density.min())


def flaw(density: Any, shape: tuple[int, ...]) -> str | None:
    """What is wrong with a density for images of this shape, or None."""
    if not isinstance(density, Tensor):
        return f"it is a {type(density).__name__}"
    if density.shape != shape:
        return f"its shape is {list(density.shape)}"
    if not torch.isfinite(density).all():
        return "it has values that are not finite"
    if (density < 0).any():
        return f"it has negative values, down to {float(density.min()):g}"
    return None


def same(one: Tensor, two: Tensor) -> bool:
    """Equal bit for bit, NaN where the other has NaN too."""
    if one.shape != two.shape or one.dtype != two.dtype:
        return False
    return bool(((one == two) | ((one != one) & (two != two))).all())


def tensors(held: Any, seen: set[int] | None = None) -> Iterator[Tensor]:
    """Every tensor in a state, whatever the state is made of, in the same order each time."""
    seen = set() if seen is None else seen
    if isinstance(held, Tensor):
        yield held
    if id(held) in seen or isinstance(held, Tensor | str | bytes | type):
        return
    seen.add(id(held))
    parts: list[Any] = list(getattr(held, "__dict__", {}).values())
    if isinstance(held, Mapping):
        parts += held.values()
    elif isinstance(held, list | tuple):
        parts += held
    elif is_dataclass(held) and not hasattr(held, "__dict__"):  # with slots
        parts += [getattr(held, each.name) for each in fields(held)]
    for part in parts:
        yield from tensors(part, seen)


def holds_graph(answer: Any) -> bool:
    """Is any tensor in it one that gradients would flow through?"""
    return any(tensor.requires_grad for tensor in tensors(answer))


@dataclass(frozen=True)
class _Watch(GBuffer):
    """A view that also gives what was not declared; `buffers` writes down what is read of it."""

    rest: Mapping[str, Tensor] = field(default_factory=dict)

    def _read(self, name: str) -> Tensor:
        if name not in self.buffers and name in self.rest and isinstance(self.buffers, _Read):
            self.buffers.read.add(name)
            return self.rest[name]
        return super()._read(name)


@dataclass(frozen=True)
class _Read(Mapping[str, Tensor]):
    """Buffers, and which of them were looked at."""

    buffers: Mapping[str, Tensor]
    read: set[str]

    def __getitem__(self, key: str) -> Tensor:
        self.read.add(key)
        return self.buffers[key]

    def __contains__(self, key: object) -> bool:
        return key in self.buffers

    def __iter__(self) -> Iterator[str]:
        return iter(self.buffers)

    def __len__(self) -> int:
        return len(self.buffers)

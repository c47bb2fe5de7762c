"""Recorded functions: what a function does on a GPU is recorded once, and run again as one launch.

A GPU waits for the program that queues hundreds of small launches. A recording of them, a CUDA
graph, is queued in one. It reads and writes the same memory whenever it runs: inputs are copied to
where the recorded operations read, and results are copied from where these write. What is recorded
once holds for all inputs of its kind: equal shapes, types, and leaves that are not tensors. So a
recorded function asks its tensors nothing (`rlbench.ops.asking`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor

from rlbench.ops.nested_tensors import map_tensors, read_leaves

__all__ = [
    "CudaGraphs",
    "Fused",
    "HeldInputs",
    "Kind",
    "RecordedFunction",
    "Recorder",
    "Tape",
    "can_record",
    "kind_of",
]

MOST_KINDS = 1000  # of frames, for which one method is compiled in a process

T = TypeVar("T")
Kind = tuple[tuple[str, Any], ...]


class Recorder(Protocol):
    """What records operations: CUDA graphs, or a stand-in that tests have."""

    def hold(self, value: Tensor) -> Tensor:
        """A copy, from whose memory recorded operations read in every run."""

    def record(self, function: Callable[[], T]) -> tuple[Callable[[], object], T]:
        """What runs the operations again, and the value whose tensors they overwrite."""


class CudaGraphs:
    """Records functions as CUDA graphs. They must have run before.

    What a first run alone does, such as the choice of a convolution, cannot be recorded.
    """

    def hold(self, value: Tensor) -> Tensor:
        """A copy outside of inference mode, so that it can be overwritten in both modes."""
        with torch.inference_mode(False):
            return value.detach().clone()

    def record(self, function: Callable[[], T]) -> tuple[Callable[[], object], T]:
        """The replay of a graph, and what the function returned."""
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        # another thread may read clips meanwhile
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            returned = function()
        return graph.replay, returned


@dataclass(frozen=True)
class Fused:
    """A recorder of functions whose operations torch.compile has fused before.

    A function has to be one graph; RuntimeError, or a subclass, is raised where it is not. Each is
    compiled when it is recorded, which takes minutes; PyTorch keeps the kernels on disk.
    """

    recorder: Recorder = field(default_factory=CudaGraphs)
    compiler: str = "inductor"  # of torch.compile

    def hold(self, value: Tensor) -> Tensor:
        """As the recorder's."""
        return self.recorder.hold(value)

    def record(self, function: Callable[[], T]) -> tuple[Callable[[], object], T]:
        """What the recorder makes of the compiled function."""
        options = {
            "trace_autograd_ops": True,  # a network that learns in each frame
            "recompile_limit": MOST_KINDS,
            "accumulated_recompile_limit": MOST_KINDS,
        }
        with torch._dynamo.config.patch(options):
            fused = torch.compile(function, backend=self.compiler, fullgraph=True, dynamic=False)
            fused()
            return self.recorder.record(fused)


class HeldInputs:
    """Inputs of one kind, in the memory from which recorded operations read them."""

    def __init__(self, recorder: Recorder, *values: Any) -> None:
        """Copies of the tensors in `values`."""
        self.values = map_tensors(recorder.hold, values)
        self._held, self._loaded = _tensors(self.values), values

    def has_loaded(self, *values: Any) -> bool:
        """True if these objects were loaded last."""
        return all(one is other for one, other in zip(values, self._loaded, strict=True))

    def load(self, *values: Any) -> None:
        """Copy the tensors of other values of this kind."""
        for held, tensor in zip(self._held, _tensors(values), strict=True):
            held.copy_(tensor)
        self._loaded = values


class Tape(Generic[T]):
    """One recorded function of held inputs."""

    def __init__(self, recorder: Recorder, function: Callable[[], T]) -> None:
        """Record `function`."""
        self._replay, self._returned = recorder.record(function)

    @property
    def returns_something(self) -> bool:
        """True unless the function returned None."""
        return self._returned is not None

    def run(self) -> T:
        """A copy of what the function returns for the values that its inputs have now."""
        self._replay()
        return map_tensors(torch.clone, self._returned)


@dataclass(frozen=True)
class RecordedFunction(Generic[T]):
    """A function of tensors, without gradients, that is recorded for each kind of arguments.

    A recording has no room for another: call `function` itself while `is_recording()`.
    """

    function: Callable[..., T]
    recorder: Recorder = field(default_factory=CudaGraphs)
    _tapes: dict[Kind, tuple[HeldInputs, Tape[T]]] = field(default_factory=dict, repr=False)

    def __call__(self, *arguments: Tensor) -> T:
        """What the function returns."""
        kind = kind_of(arguments)
        if kind not in self._tapes:
            held = HeldInputs(self.recorder, *arguments)
            with torch.inference_mode(False), torch.no_grad():
                self.function(*held.values)
                tape = Tape(self.recorder, lambda: self.function(*held.values))
            self._tapes[kind] = held, tape
        held, tape = self._tapes[kind]
        held.load(*arguments)
        return tape.run()


def can_record(recorder: Recorder, device: torch.device) -> bool:
    """True if a small function, recorded on the device, holds for other inputs."""
    double = RecordedFunction(lambda value: 2 * value, recorder)
    try:
        found = [double(torch.full((2,), value, device=device)).tolist() for value in (1.0, 3.0)]
    except (AssertionError, RuntimeError):  # PyTorch without CUDA; a device that has no graphs
        return False
    return found == [[2.0, 2.0], [6.0, 6.0]]


def kind_of(value: Any) -> Kind:
    """Shape, type and device of each tensor in a nested value, and every other leaf.

    Raises TypeError as `read_leaves` does.
    """
    return tuple(
        (path, (leaf.shape, leaf.dtype, leaf.device) if isinstance(leaf, Tensor) else leaf)
        for path, leaf in read_leaves(value)
    )


def _tensors(value: Any) -> list[Tensor]:
    return [leaf for _, leaf in read_leaves(value) if isinstance(leaf, Tensor)]

"""Planted faults: one bad value in a sample, a buffer or the state, and methods that resume."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

from torch import Tensor

from rlbench.checks.tensors import iterate_tensors
from rlbench.frames import Frame, GBuffer, Samples, Size, StoredPool
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper

__all__ = [
    "VALUES",
    "HoldDensities",
    "RecordRun",
    "ResumeRun",
    "plant_in_buffer",
    "plant_in_samples",
    "plant_in_state",
]

VALUES = {
    "nan": math.nan,
    "inf": math.inf,
    "1e30": 1e30,
    "65504": 65504.0,
    "1e5": 1e5,
    "minus-one": -1.0,
    "denormal": 1e-40,
}


def plant_in_samples(frame: Frame, value: float, y: int, x: int) -> Frame:
    """The frame with `value` in all channels of one pixel's first sample."""
    assert isinstance(frame.pool, StoredPool)
    radiance = frame.pool.radiance.clone()
    radiance[:, 0, :, y, x] = value
    return replace(frame, pool=StoredPool(radiance, frame.pool.rounding_seeds))


def plant_in_buffer(frame: Frame, name: str, value: float, y: int, x: int) -> Frame:
    """The frame with `value` in all channels of one pixel of a buffer."""
    buffer = frame.gbuffer.buffers[name].clone()
    buffer[..., y, x] = value
    buffers = {**frame.gbuffer.buffers, name: buffer}
    return replace(frame, gbuffer=GBuffer(buffers, frame.gbuffer.static))


def plant_in_state(state: State, value: float, size: Size, y: int, x: int) -> tuple[State, int]:
    """A copy of the state with `value` at one pixel, and the number of tensors that hold it.

    The pixel is (y, x) in tensors [n c h w] of the frame's size, and the middle element of tensors
    in another layout. Tensors with fewer elements than the frame has pixels hold no image: they
    stay unchanged.
    """
    copied, count = deepcopy(state), 0
    for tensor in iterate_tensors(copied):
        if tensor.is_floating_point() and tensor.numel() >= size.n * size.h * size.w:
            if tensor.shape[-2:] == (size.h, size.w):
                tensor[..., y, x] = value
            else:
                tensor.view(-1)[tensor.numel() // 2] = value
            count += 1
    return copied, count


@dataclass(frozen=True)
class RecordRun(MethodWrapper[Method]):
    """A method that records its densities, and its state before each frame."""

    densities: list[list[Tensor]] = field(default_factory=list)  # by frame and pass
    states: list[State] = field(default_factory=list)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The method's density."""
        if len(self.densities) == len(self.states):
            self.densities.append([])
        density = super().plan(gbuffer, samples, state)
        self.densities[-1].append(density)
        return density

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The method's image and next state."""
        self.states.append(state)
        return super().denoise(gbuffer, samples, state)


@dataclass(frozen=True)
class ResumeRun(MethodWrapper[Method]):
    """A method that starts from a given state, as if it had run the earlier frames."""

    state: State

    def start(self, size: Size) -> State:
        """The given state."""
        return self.state


@dataclass(frozen=True)
class HoldDensities(MethodWrapper[Method]):
    """A method that plans recorded densities, so that a fault cannot move its samples."""

    densities: list[Tensor]  # of all passes in order
    calls: list[None] = field(default_factory=list)  # one entry per call of `plan`

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The next recorded density."""
        self.calls.append(None)
        return self.densities[len(self.calls) - 1]

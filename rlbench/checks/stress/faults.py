"""Planted faults: one bad value in a sample, a buffer or the state, and methods that resume."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

from torch import Tensor

from rlbench.checks.frame_edits import stored_radiance, with_buffers
from rlbench.checks.stress.held_density import RecordDensity
from rlbench.checks.tensors import iterate_tensors
from rlbench.frames import Frame, GBuffer, Samples, Size, StoredPool
from rlbench.method import Method, State
from rlbench.wrappers import MethodWrapper

__all__ = [
    "BACKGROUND",
    "VALUES",
    "RecordRun",
    "ResumeRun",
    "brightest_sample",
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
BACKGROUND = {"albedo": 0.0, "normal": 0.0, "depth": math.inf, "motion": 1e4}  # legal values


def plant_in_samples(frame: Frame, value: float | Tensor, y: int, x: int) -> Frame:
    """The frame with `value`, a number or a colour [n 3], as one pixel's first sample."""
    radiance = stored_radiance(frame).clone()
    radiance[:, 0, :, y, x] = value
    return replace(frame, pool=StoredPool(radiance, frame.pool.rounding_seeds))


def brightest_sample(frame: Frame, y: int, x: int) -> Tensor:
    """The brightest stored sample of a pixel [n 3], for a clip without a batch."""
    samples = stored_radiance(frame)[0, :, :, y, x]
    return samples[samples.sum(1).argmax()][None]


def plant_in_buffer(frame: Frame, name: str, value: float | Tensor, y: int, x: int) -> Frame:
    """The frame with `value`, a number or one per channel [n c], in one pixel of a buffer."""
    buffer = frame.gbuffer.buffers[name].clone()
    buffer[..., y, x] = value
    return with_buffers(frame, **{name: buffer})


def plant_in_state(
    state: State, value: float | None, size: Size, y: int, x: int
) -> tuple[State, int]:
    """A copy of the state with `value` at one pixel, and the number of tensors that hold it.

    The pixel is (y, x) in tensors [n c h w] of the frame's size. In another layout it is half a
    line behind the middle of the last dimension: the centre of images that are stored line by line.
    Tensors with fewer elements than the frame has pixels hold no image: they stay unchanged. With
    None the pixel gets the values of the one halfway to the left border.
    """
    copied, count = deepcopy(state), 0
    for tensor in iterate_tensors(copied):
        if tensor.is_floating_point() and tensor.numel() >= size.n * size.h * size.w:
            is_image = tensor.shape[-2:] == (size.h, size.w)
            middle = tensor.shape[-1] // 2 + size.w // 2
            pixel = tensor[..., y, x] if is_image else tensor[..., middle]
            other = tensor[..., y, x // 2] if is_image else tensor[..., middle - size.w // 4]
            pixel.copy_(other.clone() if value is None else pixel.new_tensor(value))
            count += 1
    return copied, count


@dataclass(frozen=True)
class RecordRun(RecordDensity):
    """A method that records its densities, and its state before each frame."""

    states: list[State] = field(default_factory=list)

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

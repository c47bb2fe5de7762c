"""Lies about a G-buffer: a buffer dropped, noisy, late, of wrong sign, or constant."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from rlbench.checks.frame_edits import with_buffers
from rlbench.clips.importers.stand_ins import STAND_INS as CONSTANTS
from rlbench.frames import Frame

__all__ = ["CONSTANTS", "LIES", "tell_lie"]

NOISE = 0.1  # standard deviation, in the buffer's unit; of depth, a share of it
Lie = Callable[[str, Sequence[Tensor], int], Tensor]


def tell_lie(frames: Sequence[Frame], name: str, lie: Lie) -> list[Frame]:
    """The frames with the buffer `name` replaced by what `lie` makes of it.

    A lie receives the name, the buffer in all frames, and the index of the frame.
    """
    right = [frame.gbuffer.buffers[name] for frame in frames]
    return [with_buffers(frame, **{name: lie(name, right, i)}) for i, frame in enumerate(frames)]


def _drop(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Zero, as from a renderer that does not export the buffer."""
    return torch.zeros_like(right[index])


def _add_noise(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Gaussian noise; the result is legal: albedo in [0, 1], unit normals, no negative depth."""
    generator = torch.Generator().manual_seed(index)
    noise = NOISE * torch.randn(right[index].shape, generator=generator).to(right[index])
    if name == "albedo":
        return (right[index] + noise).clamp(0, 1)
    if name == "normal":
        is_surface = right[index].square().sum(1, keepdim=True) > 0
        return torch.nn.functional.normalize(right[index] + noise).where(is_surface, 0.0)
    if name == "depth":
        return right[index] * noise.exp()
    return right[index] + noise


def _delay(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """The buffer of the previous frame; the right one in frame 0."""
    return right[max(index - 1, 0)]


def _negate(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Every finite value with the other sign; background keeps its infinite depth."""
    return torch.where(right[index].isfinite(), -right[index], right[index])


def _flatten(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """The same legal value everywhere."""
    value = right[index].new_tensor(CONSTANTS[name]).view(-1, 1, 1)
    return value.expand_as(right[index]).contiguous()


LIES: dict[str, Lie] = {
    "dropped": _drop,
    "noised": _add_noise,
    "lagged": _delay,
    "negated": _negate,
    "constant": _flatten,
}

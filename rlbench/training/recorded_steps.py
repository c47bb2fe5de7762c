"""Training steps of which the forward and the backward pass are one launch each, for GPUs.

A step of a U-Net on crops is hundreds of small launches, and used 4 % of a card that waited for
Python. What is recorded once for a kind of sequence (crops, budget, and the weights that learn) is
run again for others. The optimiser and the average of the weights, a few launches, stay outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Clip, Frame, StoredPool
from rlbench.ops.recording import HeldInputs, Recorder, Tape, kind_of

__all__ = ["RecordedSteps"]

Backward = Callable[[Clip, float], Iterator[Tensor]]
Gradients = list[Tensor | None]


class RecordedSteps:
    """The losses of a sequence, each with its gradients in the weights, as by `backward`.

    The first sequence of each kind runs as it is, and is recorded behind its last step. Questions
    of recorded frames are not answered, so an invalid density is no error: it counts as 0.
    """

    def __init__(
        self, backward: Backward, weights: Sequence[nn.Parameter], recorder: Recorder
    ) -> None:
        """`backward` must leave new gradients in `weights` with each loss that it yields."""
        self._backward, self._weights = backward, weights
        self._recorder = recorder
        self._recorded: dict[object, tuple[HeldInputs, list[tuple[Tape[Tensor], Gradients]]]] = {}

    def __call__(self, clip: Clip, spp: float) -> Iterator[Tensor]:
        """The losses of a clip of stored samples."""
        frames = [_with_seeds_on_device(index, frame) for index, frame in enumerate(clip)]
        kind = kind_of(frames), spp, tuple(weight.requires_grad for weight in self._weights)
        if kind not in self._recorded:
            yield from self._backward(clip, spp)
            self._recorded[kind] = self._record(frames, spp)
            return
        held, steps = self._recorded[kind]
        held.load(frames)
        for tape, gradients in steps:
            loss = tape.run()
            for weight, gradient in zip(self._weights, gradients, strict=True):
                weight.grad = gradient
            yield loss

    def _record(
        self, frames: list[Frame], spp: float
    ) -> tuple[HeldInputs, list[tuple[Tape[Tensor], Gradients]]]:
        held = HeldInputs(self._recorder, frames)
        losses = self._backward(InMemoryClip("recorded", "training", "", held.values[0]), spp)
        steps: list[tuple[Tape[Tensor], Gradients]] = []
        while (tape := Tape(self._recorder, partial(next, losses, None))).returns_something:
            steps.append((tape, [weight.grad for weight in self._weights]))
        return held, steps


def _with_seeds_on_device(index: int, frame: Frame) -> Frame:
    """A frame whose seeds are a tensor, and whose number is that within its sequence."""
    pool = frame.pool
    assert isinstance(pool, StoredPool)
    seeds: Any = torch.as_tensor(pool.rounding_seeds, device=pool.radiance.device)
    return replace(frame, index=index, pool=replace(pool, rounding_seeds=seeds))

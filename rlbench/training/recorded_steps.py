"""Training steps that are one launch each, for GPUs.

A step of a U-Net on crops is hundreds of small launches, and used 4 % of a card that waited for
Python. What is recorded once for a kind of sequence (crops, budget, and the weights that learn) is
run again for others: forward and backward pass, clipping, the optimizer and the moving average.
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

__all__ = ["RecordedSteps", "Steps"]

Steps = Callable[[Clip, float], Iterator[Tensor]]  # the loss of each step of a clip at a budget


class RecordedSteps:
    """The steps of a sequence, as by `steps`.

    The first sequence of each kind runs as it is, and is recorded behind its last step. Questions
    of recorded frames are not answered, so an invalid density is not an error: it counts as 0.
    """

    def __init__(self, steps: Steps, weights: Sequence[nn.Parameter], recorder: Recorder) -> None:
        """`steps` takes a step for each loss that it yields; `weights` are those that may learn."""
        self._steps, self._weights = steps, weights
        self._recorder = recorder
        self._recorded: dict[object, tuple[HeldInputs, list[Tape[Tensor]]]] = {}

    def __call__(self, clip: Clip, spp: float) -> Iterator[Tensor]:
        """The losses of a clip of stored samples, after one step for each."""
        frames = [_with_seeds_on_device(index, frame) for index, frame in enumerate(clip)]
        kind = kind_of(frames), spp, tuple(weight.requires_grad for weight in self._weights)
        if kind not in self._recorded:
            yield from self._steps(clip, spp)
            self._recorded[kind] = self._record(frames, spp)
            return
        held, tapes = self._recorded[kind]
        held.load(frames)
        for tape in tapes:
            yield tape.run()

    def _record(self, frames: list[Frame], spp: float) -> tuple[HeldInputs, list[Tape[Tensor]]]:
        held = HeldInputs(self._recorder, frames)
        losses = self._steps(InMemoryClip("recorded", "training", "", held.values[0]), spp)
        tapes: list[Tape[Tensor]] = []
        while (tape := Tape(self._recorder, partial(next, losses, None))).returns_something:
            tapes.append(tape)
        return held, tapes


def _with_seeds_on_device(index: int, frame: Frame) -> Frame:
    """A frame whose seeds are a tensor, and whose number is that within its sequence."""
    pool = frame.pool
    assert isinstance(pool, StoredPool)
    seeds: Any = torch.as_tensor(pool.rounding_seeds, device=pool.radiance.device)
    return replace(frame, index=index, pool=replace(pool, rounding_seeds=seeds))

"""Training steps that are one launch each, for GPUs.

A step of a U-Net on crops is hundreds of small launches, and used 4 % of a card that waited for
Python. What is recorded once for a kind of sequence (crops, budget, and the weights that learn) is
run again for others: forward and backward pass, clipping, the optimizer and the moving average.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from torch import Tensor, nn

from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Clip, Frame, StoredPool
from rlbench.ops.recording import HeldInputs, Recorder, Tape, kind_of
from rlbench.ops.upload import upload

__all__ = ["RecordedSteps", "Steps"]

_logger = logging.getLogger(__name__)

Steps = Callable[[Clip, float], Iterator[Tensor]]  # the loss of each step of a clip at a budget


class RecordedSteps:
    """The steps of a sequence, as by `steps`.

    The first sequence of each kind runs as it is, and is recorded behind its last step. Questions
    of recorded frames are not answered, so an invalid density is not an error: it counts as 0.
    After steps that cannot be recorded, and a warning, all run as they are.
    """

    def __init__(self, steps: Steps, weights: Sequence[nn.Parameter], recorder: Recorder) -> None:
        """`steps` takes a step for each loss that it yields; `weights` are those that may learn."""
        self._steps, self._weights = steps, weights
        self._recorder: Recorder | None = recorder
        self._recorded: dict[object, tuple[HeldInputs, list[Tape[Tensor]]]] = {}

    def __call__(self, clip: Clip, spp: float) -> Iterator[Tensor]:
        """The losses of a clip of stored samples, after one step for each."""
        frames = [_with_seeds_on_device(index, frame) for index, frame in enumerate(clip)]
        kind = kind_of(frames), spp, tuple(weight.requires_grad for weight in self._weights)
        if kind not in self._recorded:
            yield from self._steps(clip, spp)
            if self._recorder:
                self._try_to_record(kind, self._recorder, frames, spp)
            return
        held, tapes = self._recorded[kind]
        held.load(frames)
        for tape in tapes:
            yield tape.run()

    def _try_to_record(
        self, kind: object, recorder: Recorder, frames: list[Frame], spp: float
    ) -> None:
        held, tapes = HeldInputs(recorder, frames), list[Tape[Tensor]]()
        losses = self._steps(InMemoryClip("recorded", "training", "", held.values[0]), spp)
        try:
            while (tape := Tape(recorder, partial(next, losses, None))).returns_something:
                tapes.append(tape)
            self._recorded[kind] = held, tapes
        except RuntimeError as error:
            reason = str(error).partition("\n")[0]
            _logger.warning("steps cannot be recorded, and run as they are: %s", reason)
            self._recorder = None


def _with_seeds_on_device(index: int, frame: Frame) -> Frame:
    """A frame whose seeds are a tensor, and whose number is that within its sequence."""
    pool = frame.pool
    assert isinstance(pool, StoredPool)
    seeds: Any = upload(pool.rounding_seeds, pool.radiance.device)
    return replace(frame, index=index, pool=replace(pool, rounding_seeds=seeds))

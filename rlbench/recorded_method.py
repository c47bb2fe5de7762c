"""A method whose stages are one launch each: the backend `graph` for GPUs.

A frame of `ours` is some 2,000 small launches, and at 192x192 a GPU waits for Python nine tenths of
its time.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.ops.recording import CudaGraphs, HeldInputs, Kind, Recorder, Tape, kind_of
from rlbench.wrappers import MethodWrapper

__all__ = ["RecordedMethod", "find_refusal"]

_logger = logging.getLogger(__name__)


@dataclass
class FrameTapes:
    """The stages of a frame, recorded for one kind of G-buffer and state."""

    frame: HeldInputs  # G-buffer and state
    samples: dict[Kind, HeldInputs] = field(default_factory=dict)
    plans: dict[Kind, Tape[Tensor]] = field(default_factory=dict)  # by the kind of their samples
    denoisers: dict[Kind, Tape[tuple[Tensor, State]]] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordedMethod(MethodWrapper[Method]):
    """A method whose `plan` and `denoise` are recorded, where no gradients are.

    The first frame of each kind runs as it is, and is recorded when its image is done. A method
    that counts frames in its state, outside of tensors, is recorded again for each number
    (`rlbench.ops.asking.next_age`). A method that asks its tensors for values cannot be recorded:
    it runs as it is, and `find_refusal` says why.

    Raises TypeError for a state of other parts than tensors, numbers, text, dataclasses, tuples,
    lists and dicts.
    """

    recorder: Recorder = field(default_factory=CudaGraphs)
    _tapes: dict[Kind, FrameTapes] = field(default_factory=dict, repr=False, compare=False)
    _planned: dict[Kind, Samples] = field(default_factory=dict, repr=False, compare=False)
    _refusals: list[str] = field(default_factory=list, repr=False, compare=False)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density."""
        drawn = kind_of(samples)
        tapes = self._find_tapes(gbuffer, state)
        if tapes is None or drawn not in tapes.plans:
            self._planned[drawn] = samples
            return super().plan(gbuffer, samples, state)
        tapes.frame.load(gbuffer, state)
        tapes.samples[drawn].load(samples)
        return tapes.plans[drawn].run()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image, and the next state."""
        drawn = kind_of(samples)
        tapes = self._find_tapes(gbuffer, state)
        is_recorded = tapes is not None and drawn in tapes.denoisers
        if tapes is None or not is_recorded or self._skips_plan(tapes, gbuffer, state):
            returned = super().denoise(gbuffer, samples, state)
            if not (is_recorded or self._refusals or torch.is_grad_enabled()):
                self._try_to_record(gbuffer, samples, state)
            self._planned.clear()
            return returned
        if not tapes.plans:
            tapes.frame.load(gbuffer, state)
        tapes.samples[drawn].load(samples)
        return tapes.denoisers[drawn].run()

    def _find_tapes(self, gbuffer: GBuffer, state: State) -> FrameTapes | None:
        """What is recorded of frames of this kind; None where gradients are."""
        if torch.is_grad_enabled():
            return None
        return self._tapes.get(kind_of((gbuffer, state)))

    def _skips_plan(self, tapes: FrameTapes, gbuffer: GBuffer, state: State) -> bool:
        """True if `denoise` is called alone, though it was recorded behind `plan`.

        The recorded one reads what `plan` has reprojected.
        """
        return bool(tapes.plans) and not tapes.frame.has_loaded(gbuffer, state)

    def _try_to_record(self, gbuffer: GBuffer, samples: Samples, state: State) -> None:
        try:
            self._record(gbuffer, samples, state)
        except RuntimeError as error:
            self._refusals.append(
                f"ran eagerly, as its frames cannot be recorded: {str(error).partition(chr(10))[0]}"
                '. rlbench check finds the line that asks; Traits(eager_reason="...") declares it'
            )
            _logger.warning("the method %s", self._refusals[0])

    def _record(self, gbuffer: GBuffer, samples: Samples, state: State) -> None:
        """Record the stages that this frame ran, in their order, on the same held objects."""
        recorder, drawn = self.recorder, kind_of(samples)
        tapes = FrameTapes(HeldInputs(recorder, gbuffer, state))
        frame, before = tapes.frame.values
        for kind, given in (*self._planned.items(), (drawn, samples)):
            tapes.samples.setdefault(kind, HeldInputs(recorder, given))
        for kind in self._planned:
            (seen,) = tapes.samples[kind].values
            plan = partial(self.method.plan, frame, seen, before)
            tapes.plans[kind] = Tape(recorder, plan)
        (seen,) = tapes.samples[drawn].values
        denoise = partial(self.method.denoise, frame, seen, before)
        tapes.denoisers[drawn] = Tape(recorder, denoise)
        self._tapes[kind_of((gbuffer, state))] = tapes


def find_refusal(method: Method) -> str:
    """Why a method ran eagerly in spite of its backend, or an empty string."""
    while isinstance(method, MethodWrapper):
        if isinstance(method, RecordedMethod) and method._refusals:
            return method._refusals[0]
        method = method.method
    return ""

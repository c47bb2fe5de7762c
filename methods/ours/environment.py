"""`ours` as a world of reinforcement learning: crops of clips, its other networks behind it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.frame_problem import FrameProblem
from methods.ours.method import Ours
from methods.ours.policy.environment import StepResult
from methods.ours.state import RecurrentState
from rlbench.frames import Frame
from rlbench.training.batches import Batches, sample_budget


class SamplingEnv:
    """Sequences of crops, one at a time, each at a budget of its own; what acts is the sampler.

    A `World` (methods/ours/policy/environment.py). `turn` is the frame in which it is to act now.
    """

    turn: FrameProblem

    def __init__(self, method: Ours, batches: Batches, budgets: Sequence[float]) -> None:
        """From the draws of `batches`, of one clip each; budgets in samples per pixel."""
        self.method, self.batches, self.budgets = method, batches, tuple(budgets)
        self.shape = (method.networks.foreseen, batches.crop, batches.crop)
        self._draw = 0

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """The first frame of the next draw."""
        clip = self.batches.sequence(self._draw)
        self._spp = sample_budget(self.budgets, self.batches.seed, self._draw)
        self._draw += 1
        self._frames = iter(clip)
        self._go(next(self._frames), self.method.start(clip.size))
        return self.turn.seen

    @torch.no_grad()
    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Buy, encode and denoise; the error is that of Turn."""
        errors, counts, state = self.turn.take(action)
        following = next(self._frames, None)
        if following is not None:
            self._go(following, state)
        return StepResult(errors, counts, self.turn.seen, following is None)

    def _go(self, frame: Frame, state: RecurrentState) -> None:
        self.turn = FrameProblem(
            self.method, frame, frame.gbuffer.select(self.method.traits.inputs), state, self._spp
        )

"""`ours` as a reinforcement-learning environment: episodes of crops, the sampler acts."""

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

__all__ = ["SamplingEnv"]


class SamplingEnv:
    """An `Env` (methods/ours/policy/environment.py) around the other networks of `ours`.

    An episode is a sequence of crops from one clip, at a budget drawn for the episode. `problem` is
    the frame in which the sampler acts next.
    """

    problem: FrameProblem

    def __init__(self, method: Ours, batches: Batches, budgets: Sequence[float]) -> None:
        """Episodes are the draws of `batches`, of one clip each; `budgets` in spp."""
        self.method, self.batches, self.budgets = method, batches, tuple(budgets)
        self.shape = (method.networks.sampler_channels, batches.crop, batches.crop)
        self._draw = 0

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Start the next episode; returns the observation of its first frame."""
        clip = self.batches.sequence(self._draw)
        self._spp = sample_budget(self.budgets, self.batches.seed, self._draw)
        self._draw += 1
        self._frames = iter(clip)
        self._enter(next(self._frames), self.method.start(clip.size))
        return self.problem.observation

    @torch.no_grad()
    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Draw samples by an action, denoise, and enter the next frame."""
        errors, counts, state = self.problem.step(action)
        frame = next(self._frames, None)
        if frame is not None:
            self._enter(frame, state)
        return StepResult(errors, counts, self.problem.observation, frame is None)

    def _enter(self, frame: Frame, state: RecurrentState) -> None:
        self.problem = FrameProblem.of_frame(self.method, frame, state, self._spp)

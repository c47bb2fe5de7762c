"""One frame of an episode as an allocation problem: a map also answers for later frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.frame_problem import FrameProblem, FrameStep
from methods.ours.policy import Rollout
from methods.ours.policy.discounted_return import discounted_return
from rlbench.frames import Frame

__all__ = ["EpisodeProblem", "reward"]

HIGHEST_REWARD = 10.0


def reward(error: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """10^(1 - error), the paper's reward of a loss; 10 without error, at least 1 up to an error 1.

    >>> reward(torch.tensor([0.0, 1.0]))
    tensor([10.,  1.])
    """
    return HIGHEST_REWARD ** (1 - error)


@dataclass(frozen=True)
class EpisodeProblem(FrameProblem):
    """A FrameProblem whose rollouts end with the episode.

    After an action, the sampler goes on with its mean actions. The result of a pixel is its
    discounted return, which follows the motion (`policy/discounted_return.py`).
    """

    later: Sequence[Frame] = ()  # frames of the episode after this one
    gamma: float = 0.0  # discount per frame

    @classmethod
    def of_problem(
        cls, problem: FrameProblem, later: Sequence[Frame], gamma: float
    ) -> EpisodeProblem:
        """The problem of a frame that later frames follow."""
        parts = (problem.method, problem.frame, problem.gbuffer, problem.state, problem.spp)
        return cls(*parts, later, gamma)

    @torch.no_grad()
    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Counts of k actions in this frame, and what their returns lack to the highest."""
        steps = [self.step(action) for action in actions]
        counts = torch.stack([step.counts for step in steps])
        costs, motions = [_cost(steps)], []
        for frame in self.later:
            following = FrameProblem.of_frame(self.method, frame, steps[0].state, self.spp)
            problems = [replace(following, state=step.state) for step in steps]
            steps = [problem.step(problem.act()) for problem in problems]
            costs.append(_cost(steps))
            motions.append(following.gbuffer.motion)
        return Rollout(discounted_return(costs, motions, self.gamma), counts)


def _cost(steps: Sequence[FrameStep]) -> Float[Tensor, "k n 1 h w"]:
    """The highest reward less the reward of each pixel, >= 0."""
    return HIGHEST_REWARD - reward(torch.stack([step.errors for step in steps]))

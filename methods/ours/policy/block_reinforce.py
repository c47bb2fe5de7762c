"""REINFORCE per block as a learner: several actions on each frame, compared with each other."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.block_policy_gradient import BlockPolicyGradient, RolloutBatch
from methods.ours.policy.interface import AllocationProblem

__all__ = ["BlockReinforce"]


@dataclass
class BlockReinforce:
    """Rolls out several actions around the mean from one state, and compares their errors.

    Each set of actions is used for one step, so the ratio of new to old probability is 1 and the
    clipping of PPO never acts: in this limit the proximal loss is REINFORCE (Williams 1992).
    """

    policy: BlockPolicyGradient = BlockPolicyGradient()  # noqa: RUF009  (frozen)
    min_samples: int = 0
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss over its `draws` actions."""
        mean, corner = problem.act(), self.policy.draw_corner(generator)
        actions = self.policy.antithetic_actions(mean, corner, generator)
        rollout = problem.rollout(actions)
        batch = RolloutBatch(
            actions, rollout.errors, rollout.counts, corner, problem.multiplicative
        )
        return self.policy.loss(mean, batch)

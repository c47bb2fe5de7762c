"""The policy gradient with local credit and a price, as a learner: several draws of each frame."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.block_policy_gradient import BlockPolicyGradient, RolloutBatch
from methods.ours.policy.interface import AllocationProblem


@dataclass
class BlockReinforce:
    """Draws around the mean, tried from the same state and compared with each other.

    One step is taken on each set of draws, so that the ratio of new to old probability is 1 and
    clipping never acts: this is the limit in which a proximal loss is REINFORCE.
    """

    policy: BlockPolicyGradient = BlockPolicyGradient()  # noqa: RUF009  (frozen)
    floor: int = 0
    network: None = None

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss of as many trials as it draws."""
        mean, corner = situation.act(), self.policy.corner(generator)
        actions = self.policy.antithetic_actions(mean, corner, generator)
        trial = situation.rollout(actions)
        drawn = RolloutBatch(actions, trial.errors, trial.counts, corner, situation.multiplicative)
        return self.policy.loss(mean, drawn)

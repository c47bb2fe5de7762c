"""The policy gradient with local credit and a price, as a learner: several draws of each frame."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.block_policy_gradient import Draws, Policy
from methods.ours.policy.interface import Situation


@dataclass
class PpoPixel:
    """Draws around the mean, tried from the same state and compared with each other.

    One step is taken on each set of draws, so that the ratio of new to old probability is 1 and
    clipping never acts: this is the limit in which a proximal loss is REINFORCE.
    """

    policy: Policy = Policy()  # noqa: RUF009  (frozen)
    floor: int = 0
    network: None = None

    def loss(self, situation: Situation, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss of as many trials as it draws."""
        mean, corner = situation.act(), self.policy.corner(generator)
        actions = self.policy.tries(mean, corner, generator)
        trial = situation.attempt(actions)
        drawn = Draws(actions, trial.errors, trial.counts, corner, situation.factors)
        return self.policy.loss(mean, drawn)

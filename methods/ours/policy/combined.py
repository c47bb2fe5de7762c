"""Trial and gradient together: the policy gradient, and the surrogate where samples suffice."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.policy.interface import AllocationProblem
from methods.ours.policy.surrogate_gradient import SurrogateLearner


@dataclass
class CombinedLearner:
    """The sum of two estimates of one gradient, whose faults are opposite.

    The policy gradient counts all that a sample does, in pixels around it and in those that have
    none, and is noisy. The surrogate has little noise, but takes what a denoiser makes of counts as
    given, and says nothing of pixels without samples: it joins at budgets that could give every
    pixel one, though none is bound to have it. Behind the networks of `ours` both are about equally
    long, and they are not weighted.
    """

    trial: BlockReinforce = field(default_factory=BlockReinforce)
    gradient: SurrogateLearner = field(default_factory=SurrogateLearner)
    floor: int = 0
    network: None = None

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss and, from 1 spp on, the image's."""
        loss = self.trial.loss(situation, generator)
        if situation.spp >= self.gradient.floor:
            loss = loss + self.gradient.loss(situation, generator)
        return loss

"""REINFORCE and the surrogate gradient together, where the budget allows the latter."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.policy.interface import AllocationProblem
from methods.ours.policy.surrogate_gradient import SurrogateLearner

__all__ = ["CombinedLearner"]


@dataclass
class CombinedLearner:
    """The sum of two estimates of one gradient, with opposite faults.

    REINFORCE counts every effect of a sample, on neighbouring pixels and on pixels without samples,
    but is noisy. The surrogate gradient has little noise, but ignores that the denoiser reads the
    counts, and says nothing about pixels without samples: it joins at budgets of 1 spp and more,
    which could give every pixel a sample, though no pixel has to have one. Behind the networks of
    `ours` both have about the same length, and they are not weighted.
    """

    reinforce: BlockReinforce = field(default_factory=BlockReinforce)
    surrogate: SurrogateLearner = field(default_factory=SurrogateLearner)
    min_samples: int = 0
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss and, from 1 spp on, the image's."""
        loss = self.reinforce.loss(problem, generator)
        if problem.spp >= self.surrogate.min_samples:
            loss = loss + self.surrogate.loss(problem, generator)
        return loss

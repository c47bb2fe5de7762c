"""The gradient approximation: every bought sample moves towards the truth as its share grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.interface import AllocationProblem
from rlbench.frames import Frame, Samples
from rlbench.training.surrogate_gradient import SampleGradient


def pull_each(samples: Samples, due: Float[Tensor, "n 1 h w"], frame: Frame) -> Samples:
    """The same samples, each of which moves towards the truth as the share that is due grows.

    For methods that read samples one by one (A1 of Scardigli et al. 2023). One sample more would
    move the mean of s samples by (T - I) / s on average (Kuznetsov et al. 2018); here every filled
    slot X has dX/ds = (T - X) / s, so that their mean has exactly that. Empty slots contribute
    nothing, where the authors' release also counts the padding. At a count of 0 there is no slope.
    """
    nought = (due - due.detach()).unsqueeze(1)  # zero, but with a gradient
    counts = samples.counts.clamp_min(1).unsqueeze(1)
    away = (frame.reference.mean.unsqueeze(1) - samples.radiance).detach() / counts
    return replace(
        samples, radiance=samples.radiance + nought * away.where(samples.valid_mask, 0.0)
    )


@dataclass
class SurrogateLearner:
    """No trial and no error: the image's own loss, differentiated through what was bought."""

    teach: SampleGradient = pull_each
    floor: int = 1  # a pixel without samples has no slope
    network: None = None

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The image's loss; pixels at a bound get no gradient, the normalisation is in it."""
        return situation.surrogate_loss(self.teach)

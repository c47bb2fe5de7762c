"""The surrogate gradient: every drawn sample moves towards the truth as its count grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.interface import AllocationProblem
from rlbench.frames import Frame, Samples
from rlbench.training.surrogate_gradient import SampleGradient

__all__ = ["SurrogateLearner", "kuznetsov_gradient_per_sample"]


def kuznetsov_gradient_per_sample(
    samples: Samples, relaxed_counts: Float[Tensor, "n 1 h w"], frame: Frame
) -> Samples:
    """The same samples, with a gradient to the relaxed counts in each of them.

    For methods that read samples one by one (A1 of Scardigli et al. 2023). One sample more would
    move the mean of s samples by (T - I) / s on average (Kuznetsov et al. 2018); here every filled
    slot X has dX/ds = (T - X) / s, so that their mean has exactly that gradient. Empty slots
    contribute nothing, where the authors' release also counts the padding. A pixel without samples
    has no gradient.
    """
    zero = (relaxed_counts - relaxed_counts.detach()).unsqueeze(1)  # with a gradient of 1
    counts = samples.counts.clamp_min(1).unsqueeze(1)
    slope = (frame.reference.mean.unsqueeze(1) - samples.radiance).detach() / counts
    return replace(samples, radiance=samples.radiance + zero * slope.where(samples.valid_mask, 0.0))


@dataclass
class SurrogateLearner:
    """No exploration: the image's own loss, differentiated through the drawn samples."""

    sample_gradient: SampleGradient = kuznetsov_gradient_per_sample
    min_samples: int = 1  # a pixel without samples has no gradient
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The image's loss.

        The gradient includes the normalisation to the budget; pixels at a bound get none.
        """
        return problem.surrogate_loss(self.sample_gradient)

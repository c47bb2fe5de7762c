"""Gradients through the drawn samples: the surrogate, the gamma model, and with REINFORCE."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.policy.gamma_samples import redraw_as_gamma
from methods.ours.policy.learner import AllocationProblem, SamplerLearner
from methods.ours.policy.reinforce import BlockReinforce
from rlbench.frames import Frame, Samples
from rlbench.training.surrogate_gradient import SampleGradient

FREE_MEAN = 0.5  # largest mean action of an image, in [-1, 1], that nothing pulls back


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


def gamma_gradient_per_sample(
    samples: Samples, relaxed_counts: Float[Tensor, "n 1 h w"], frame: Frame
) -> Samples:
    """The same samples, scaled so that their mean is a new draw of `relaxed_counts` samples.

    As in Salehi et al. 2022, by `gamma_samples`, but for methods that read samples one by
    one, which that paper does not treat: slots keep their ratios, and with them what they say about
    the noise. Pixels whose samples are all black show the drawn mean in every filled slot.
    """
    drawn = redraw_as_gamma(samples, relaxed_counts, frame).radiance  # n 1 3 h w
    mean = samples.mean.unsqueeze(1)
    black = mean <= 0
    scaled = samples.radiance / mean.where(~black, 1.0) * drawn
    scaled = scaled.where(~black, drawn)
    return replace(samples, radiance=scaled.where(samples.valid_mask, 0.0))


@dataclass
class SurrogateLearner(SamplerLearner):
    """No exploration: the image's own loss, differentiated through the drawn samples."""

    sample_gradient: SampleGradient = kuznetsov_gradient_per_sample
    min_samples = 1  # a pixel without samples has no gradient

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The image's loss, which grows where the mean action leaves the middle half of its range.

        The gradient includes the normalisation to the budget; pixels at a bound get none. The
        budget cancels what all actions have in common, so they would drift to where tanh is flat:
        in the paper's recipe all densities became zero after 3,000 crops. A pull that acts in the
        middle too, or does not scale with the loss, outweighs the gradient of the image.
        """
        loss = problem.surrogate_loss(self.sample_gradient)
        excess = (problem.act().mean((1, 2, 3)).abs() - FREE_MEAN).clamp_min(0)
        return loss + loss.detach() * excess.square().mean()


@dataclass
class CombinedLearner(SamplerLearner):
    """The sum of two estimates of one gradient, with opposite faults.

    REINFORCE counts every effect of a sample, on neighbouring pixels and on pixels without samples,
    but is noisy. The surrogate gradient has little noise, but ignores that the denoiser reads the
    counts, and says nothing about pixels without samples: it joins at budgets of 1 spp and more,
    which could give every pixel a sample, though no pixel has to have one. Behind the networks of
    `ours` both have about the same length, and they are not weighted.
    """

    reinforce: BlockReinforce = field(default_factory=BlockReinforce)
    surrogate: SurrogateLearner = field(default_factory=SurrogateLearner)

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss and, from 1 spp on, the image's."""
        loss = self.reinforce.loss(problem, generator)
        if problem.spp >= self.surrogate.min_samples:
            loss = loss + problem.surrogate_loss(self.surrogate.sample_gradient)
        return loss

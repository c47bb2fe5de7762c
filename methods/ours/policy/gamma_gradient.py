"""The analytic gradient: samples scaled to a gamma-distributed mean, smooth in their number."""

from __future__ import annotations

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from baselines.dasr import gamma
from methods.ours.policy.surrogate_gradient import SurrogateLearner
from rlbench.frames import Frame, Samples

__all__ = ["gamma_gradient_per_sample", "make_gamma_learner"]


def gamma_gradient_per_sample(
    samples: Samples, relaxed_counts: Float[Tensor, "n 1 h w"], frame: Frame
) -> Samples:
    """The same samples, scaled so that their mean is a new draw of `relaxed_counts` samples.

    As in Salehi et al. 2022, by `baselines.dasr.gamma`, but for methods that read samples one by
    one, which that paper does not treat: slots keep their ratios, and with them what they say about
    the noise. Pixels whose samples are all black show the drawn mean in every filled slot.
    """
    drawn = gamma.redraw_as_gamma(samples, relaxed_counts, frame).radiance  # n 1 3 h w
    mean = samples.mean.unsqueeze(1)
    black = mean <= 0
    scaled = samples.radiance / mean.where(~black, 1.0) * drawn
    scaled = scaled.where(~black, drawn)
    return replace(samples, radiance=scaled.where(samples.valid_mask, 0.0))


def make_gamma_learner() -> SurrogateLearner:
    """A learner that differentiates the image's loss through such samples."""
    return SurrogateLearner(gamma_gradient_per_sample)

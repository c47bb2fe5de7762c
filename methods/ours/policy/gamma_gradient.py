"""The analytic gradient: samples scaled to a gamma-distributed mean, smooth in their number."""

from __future__ import annotations

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from baselines.dasr import gamma
from methods.ours.policy.surrogate_gradient import SurrogateLearner
from rlbench.frames import Frame, Samples


def gamma_each(samples: Samples, due: Float[Tensor, "n 1 h w"], frame: Frame) -> Samples:
    """The same samples, scaled so that their mean is one of `due` samples drawn anew.

    In the way of Salehi et al. 2022, as `baselines.dasr.gamma` draws it, for methods that read
    samples one by one, which that paper does not treat: slots keep their ratios, so what they tell
    of the noise stays. Pixels whose samples are all black show the drawn mean in every filled slot.
    """
    drawn = gamma.gamma(samples, due, frame).radiance  # n 1 3 h w
    mean = samples.mean.unsqueeze(1)
    black = mean <= 0
    scaled = samples.radiance / mean.where(~black, 1.0) * drawn
    scaled = scaled.where(~black, drawn)
    return replace(samples, radiance=scaled.where(samples.valid_mask, 0.0))


def learner() -> SurrogateLearner:
    """The learner: the image's loss on such samples."""
    return SurrogateLearner(gamma_each)

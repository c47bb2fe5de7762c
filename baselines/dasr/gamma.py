"""Samples drawn anew for training: gamma-distributed means, smooth in how many were taken."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.frames import Frame, Samples, StoredPool

WINDOW = 3  # side of the square of pixels whose variances are averaged
SPARSE = 1e-2  # gamma shapes below this are drawn as this: nearly all draws are black
SMOOTH = 1e5  # gamma shapes above this are not drawn: their deviation is below 0.3 %


def gamma(samples: Samples, due: Float[Tensor, "n 1 h w"], frame: Frame) -> Samples:
    """In place of what was bought, one mean a pixel, as of `due` samples that were never taken.

    In the way of Salehi et al. 2022, Deep Adaptive Sampling and Reconstruction using Analytic
    Distributions, of which little more than the gamma distribution could be confirmed; so what
    this trains is not their system. Ours: each colour by itself, the mean from the reference, the
    variance from the stored samples, and a draw that is independent of the pilot, so that
    training does not see the bias that the pilot leaves in the mean. Trainer's only: a method has
    neither reference nor pool. One seed a frame, from the pool.
    """
    assert isinstance(frame.pool, StoredPool)
    radiance = frame.pool.radiance
    generator = torch.Generator(radiance.device).manual_seed(frame.pool.rounding_seeds[0])
    drawn = draw_gamma_mean(frame.reference.mean.clamp_min(0), sample_variance(radiance), due, generator)
    return Samples(drawn.unsqueeze(1), torch.ones_like(samples.counts))


def sample_variance(radiance: Float[Tensor, "n s 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Variance of one sample: that of the stored ones, unbiased, averaged over 3x3 pixels.

    Of 8 samples it is mostly too small where light is rare: that is seldom among them. What is not
    finite counts as 0.
    """
    each = radiance.var(1).nan_to_num(0.0, posinf=0.0)  # n 3 h w
    reach = WINDOW // 2
    return F.avg_pool2d(F.pad(each, (reach,) * 4, mode="replicate"), WINDOW, stride=1)


def draw_gamma_mean(
    mean: Float[Tensor, "n c h w"],
    variance: Float[Tensor, "n c h w"],
    number: Float[Tensor, "n 1 h w"],
    generator: torch.Generator,
) -> Float[Tensor, "n c h w"]:
    """A mean of `number` samples, any positive real: of that mean, and variance / number.

    Gamma with shape k = number mean^2 / variance and scale mean / k. The gradient to `number` is
    the implicit one of Figurnov et al. 2018, as in torch.distributions.Gamma.rsample. Where k is
    above 1e5 it is `mean` itself, without gradient, as where the variance or the mean is zero;
    where k is below 0.01 the mean is kept, but deviation and gradient are those of 0.01 and zero.
    """
    shape = number * mean.square() / variance.clamp_min(torch.finfo(mean.dtype).tiny)
    noisy = (shape < SMOOTH) & (mean > 0)
    shape = shape.where(noisy, 1.0).clamp_min(SPARSE)
    # the distribution of torch takes no generator; this is the function that it calls
    drawn = torch._standard_gamma(shape, generator=generator)
    return torch.where(noisy, mean / shape * drawn, mean)

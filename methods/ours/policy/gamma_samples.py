"""Samples that are smooth in their number: means of gamma-distributed light, drawn anew."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import Frame, Samples, StoredPool
from rlbench.ops.box_filter import box_mean

WINDOW = 3  # side of the window over which variances are averaged, pixels
MIN_SHAPE = 1e-2  # lower bound of the gamma shape; below it nearly all draws are black
MAX_SHAPE = 1e5  # at larger gamma shapes the deviation is below 0.3 %, and the mean is used


def redraw_as_gamma(
    samples: Samples, relaxed_counts: Float[Tensor, "n 1 h w"], frame: Frame
) -> Samples:
    """One sample per pixel in place of `samples`: the mean of `relaxed_counts` simulated samples.

    After Salehi et al. 2022, Deep Adaptive Sampling and Reconstruction using Analytic
    Distributions. Only the gamma distribution could be confirmed, so this does not reproduce their
    system. Our choices: colour channels are independent; the mean comes from the reference and the
    variance from the stored samples; draws are independent of the pilot, so training does not see
    the bias that the pilot adds to the mean.

    For training only, because it reads the reference and the pool. The random seed comes from the
    frame's pool, so equal frames give equal draws.
    """
    assert isinstance(frame.pool, StoredPool)
    radiance = frame.pool.radiance
    generator = torch.Generator(radiance.device).manual_seed(frame.pool.rounding_seeds[0])
    mean = frame.reference.mean.clamp_min(0)
    simulated = draw_gamma_mean(mean, sample_variance(radiance), relaxed_counts, generator)
    return Samples(simulated.unsqueeze(1), torch.ones_like(samples.counts))


def sample_variance(radiance: Float[Tensor, "n s 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Unbiased variance of one sample, from the stored samples, averaged over 3 x 3 pixels.

    With 8 stored samples the estimate is mostly too small where light is rare, because few of them
    contain it. Variances that are not finite count as 0.
    """
    per_pixel = radiance.var(1).nan_to_num(0.0, posinf=0.0)  # n 3 h w
    return box_mean(per_pixel, WINDOW)


def draw_gamma_mean(
    mean: Float[Tensor, "n c h w"],
    variance: Float[Tensor, "n c h w"],
    count: Float[Tensor, "n 1 h w"],
    generator: torch.Generator,
) -> Float[Tensor, "n c h w"]:
    """A random mean of `count` samples, any positive real: expectation `mean`, variance v / count.

    Gamma with shape k = count mean^2 / variance and scale mean / k. The gradient with respect to
    `count` is the implicit gradient of Figurnov et al. 2018, as in
    torch.distributions.Gamma.rsample. Where k > 1e5, or the variance or the mean is zero, the
    result is `mean` without gradient. Where k < 0.01, the expectation is exact, but the deviation
    is that of k = 0.01 and the gradient is zero.

    >>> ones = torch.ones(1, 1, 100, 100)
    >>> means = draw_gamma_mean(ones, 4 * ones, 2 * ones, torch.Generator().manual_seed(0))
    >>> abs(means.mean().item() - 1) < 0.1, abs(means.var().item() - 4 / 2) < 0.5
    (True, True)
    """
    shape = count * mean.square() / variance.clamp_min(torch.finfo(mean.dtype).tiny)
    is_noisy = (shape < MAX_SHAPE) & (mean > 0)
    shape = shape.where(is_noisy, 1.0).clamp_min(MIN_SHAPE)
    # torch.distributions.Gamma accepts no generator; this is the function that it calls
    unscaled = torch._standard_gamma(shape, generator=generator)
    return torch.where(is_noisy, mean / shape * unscaled, mean)

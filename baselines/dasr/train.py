"""Train DASR: its loss, its three stages, and samples that are smooth in their number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from baselines.dasr import FAMILY
from baselines.dasr.method import Dasr
from baselines.dasr.network import Networks
from baselines.oidn import equal_start
from rlbench.frames import Clip, Frame, Samples, StoredPool
from rlbench.ops.box_filter import box_mean
from rlbench.run import unroll
from rlbench.training import (
    BUDGETS_FROM_1_SPP,
    SampleGradient,
    SurrogateGradient,
    TrainingTask,
    kuznetsov_gradient,
)

LR_MULTIPLIERS = {"sampler": 0.2}  # learning rate 1e-4
STAGES = (  # end of each stage as a fraction of the training, and the networks that it trains
    (25 / 70, frozenset({"denoiser"})),
    (30 / 70, frozenset({"sampler"})),
    (1.0, frozenset({"denoiser", "sampler"})),
)

EPS = 0.01  # added to the reference before dividing by it
SIGMA = 1.5  # of the Gaussian and of the Laplacian of Gaussian, pixels
RADIUS = 5  # of both filters, pixels: 11 taps

WINDOW = 3  # side of the window over which variances are averaged, pixels
DRAWS_GAMMA = "the gamma distribution is drawn by a generator that the host seeds"
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


SAMPLE_GRADIENTS: dict[str, SampleGradient] = {
    "": kuznetsov_gradient,
    "gamma": redraw_as_gamma,  # does the sampler learn better from a smooth sample model?
}


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """DASR with seeded weights, its loss and its three stages.

    Kuznetsov et al. 2018, as in the training code behind `network.UNet`: 25,000 steps for the
    denoiser, 5,000 for the sampler and 40,000 for both, at 4 samples per pixel. Here the same
    fractions of the steps that every method gets, at random budgets. The sampling map starts
    exactly uniform, so the first stage trains the denoiser on uniform samples. The variant `intel`
    has one stage, and its task is that of `baselines.oidn.equal_start`.
    """
    if variant == "intel":
        return equal_start.training_task(FAMILY.variants[variant].traits, device)
    networks = Networks()
    networks.init_weights(seed)
    for weight in networks.sampler.last.parameters():
        nn.init.zeros_(weight)
    networks.to(device)
    method = Dasr(networks, FAMILY.variants[variant].traits)
    # compare the raw output, log(1 + L): clamped values would get no gradient
    undecoded = replace(method, decode=lambda log_radiance: log_radiance)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        trained = SurrogateGradient(undecoded, iter(clip), spp, SAMPLE_GRADIENTS[variant])
        for result in unroll(trained, clip, spp):
            yield relative_loss(result.image, result.frame.reference.mean.clamp_min(0).log1p())

    def select_stage(fraction_done: float) -> None:
        trainable = next(names for end, names in STAGES if fraction_done < end)
        for name, network in networks.named_children():
            network.requires_grad_(name in trainable)

    return TrainingTask(
        method,
        networks,
        losses,
        BUDGETS_FROM_1_SPP,
        lr_multipliers=LR_MULTIPLIERS,
        on_progress=select_stage,
        eager_reason=DRAWS_GAMMA if variant == "gamma" else "",
    )


def relative_loss(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """Relative L1 error of colour plus relative L1 error of edges, weights 1 and 1.

    mean(|x - y| / (y + 0.01) + |edges(x) - edges(y)| / (y + 0.01)), where edges are found by a
    Laplacian of Gaussian after a Gaussian. Image x and reference y are given as log(1 + L).
    Kuznetsov et al. 2018, as in the training code behind `network.UNet`. Computed in float32,
    also under autocast.
    """
    with torch.autocast(image.device.type, enabled=False):
        difference, scale = (image - reference).float(), reference.float() + EPS
        # filters are linear: the difference of filtered images is the filtered difference
        error = laplacian_of_gaussian(difference).abs() + difference.abs()
        return (error / scale).mean()


def laplacian_of_gaussian(image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """Laplacian of Gaussian of the Gaussian-filtered image; zero beyond the border.

    Both filters have a sigma of 1.5 pixels and 11 x 11 taps; the second derivative is that of the
    Gaussian in closed form.
    """
    offset = torch.arange(-RADIUS, RADIUS + 1, device=image.device, dtype=image.dtype)
    gaussian = torch.softmax(-offset * offset / (2 * SIGMA**2), dim=0)
    second_derivative = gaussian * (offset * offset / SIGMA**4 - 1 / SIGMA**2)
    blurred = _separable_filter(image, gaussian, gaussian)
    return _separable_filter(blurred, second_derivative, gaussian) + _separable_filter(
        blurred, gaussian, second_derivative
    )


def _separable_filter(image: Tensor, vertical: Tensor, horizontal: Tensor) -> Tensor:
    """Filter each channel along the columns, then along the rows."""
    n, c, h, w = image.shape
    planes = image.reshape(n * c, 1, h, w)
    planes = F.conv2d(planes, vertical.view(1, 1, -1, 1), padding=(RADIUS, 0))
    return F.conv2d(planes, horizontal.view(1, 1, 1, -1), padding=(0, RADIUS)).view(n, c, h, w)

"""Train DASR: its loss and its three stages."""

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
from rlbench.frames import Clip
from rlbench.run import unroll
from rlbench.training import (
    BUDGETS_FROM_1_SPP,
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
        trained = SurrogateGradient(undecoded, iter(clip), spp, kuznetsov_gradient)
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

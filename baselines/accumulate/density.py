"""Densities by rule: from the history of a pixel's neighbourhood, without learning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.accumulate.memory import History
from rlbench.ops.asking import may_ask
from rlbench.ops.box_filter import box_mean
from rlbench.ops.color import luminance
from rlbench.ops.transfer import log_inverse

UNIFORM_SHARE = 0.5  # density that every pixel gets, where the rule's mean is 1
MAX_DENSITY = 4.0  # times the rule's mean
NEW_PIXELS = 0.9  # quantile of the rule that pixels without history get
KNOWN = 0.3  # least similarity of a pixel with history
DARK = 0.05  # radiance added to the image before deviations are divided by it
CONTRAST_SIDE, BLUR_SIDE = 3, 3  # pixels, sides of the windows of the contrast rule
DEVIATION_SIDE = 7  # pixels, side of the window that variances are averaged over

DensityRule = Callable[[History], Tensor]


class HasImage(Protocol):
    """A history with the last image."""

    @property
    def image(self) -> Float[Tensor, "n 3 h w"]:
        """The last image at the current pixels, log transfer."""


def contrast(history: HasImage) -> Float[Tensor, "n 1 h w"]:
    """Roughness of the last image: its distance from its 3x3 mean in log transfer, blurred."""
    image = history.image
    rough = (image - box_mean(image, CONTRAST_SIDE)).abs().mean(1, keepdim=True)
    return box_mean(rough, BLUR_SIDE)


def deviation(history: History) -> Float[Tensor, "n 1 h w"]:
    """Standard deviation of one sample, relative to the image (Neyman 1934).

    Of all densities, one in proportion to the deviation gives the mean of each pixel's samples the
    least total variance. Dividing by the image approximates the eye's response.
    """
    scale = luminance(log_inverse(history.image)).clamp_min(0) + DARK
    return box_mean(history.radiance.variance / scale.square(), DEVIATION_SIDE).sqrt()


def denoised_deviation(history: History) -> Float[Tensor, "n 1 h w"]:
    """Standard deviation of the denoised image, in log transfer.

    In the spirit of Firmino et al. 2023, Denoising-Aware Adaptive Sampling for Monte Carlo Ray
    Tracing, who propagate the samples' variance through the denoiser. Here the variance is half
    the mean square of the change between the denoised images of consecutive frames.
    """
    return box_mean(history.change / 2, DEVIATION_SIDE).sqrt()


DENSITY_RULES: Mapping[str, DensityRule] = {
    "contrast": contrast,
    "deviation": deviation,
    "denoised deviation": denoised_deviation,
}


def mix_with_uniform(
    rule: Float[Tensor, "n 1 h w"], similarity: Float[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The density 0.5 + rule / mean, where no pixel of the rule exceeds 4 times the mean.

    The uniform share keeps pixels that the rule takes for easy from being starved. Pixels without
    history get the value that the roughest tenth of the others reach.
    """
    known = similarity > KNOWN
    rule = rule.where(known, _quantile(rule, known))
    mean = rule.mean((2, 3), keepdim=True).clamp_min(1e-6)
    return UNIFORM_SHARE + (rule / mean).clamp(0, MAX_DENSITY)


def _quantile(
    values: Float[Tensor, "n 1 h w"], known: Bool[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 1 1 1"]:
    """The 0.9 quantile of the known values of each image; 1 if none is known."""
    images, count = values.where(known, torch.inf).flatten(1), known.flatten(1).sum(1)
    if not may_ask(count):
        rank = (NEW_PIXELS * (count - 1).double()).round().long().clamp_min(0)
        ranked = images.sort(1).values.gather(1, rank[:, None])[:, 0]
        return ranked.where(count > 0, 1.0).view(-1, 1, 1, 1)
    quantiles = [
        image.kthvalue(round(NEW_PIXELS * (count - 1)) + 1).values if count else image.new_ones(())
        for image, count in zip(images, count.tolist(), strict=True)
    ]
    return torch.stack(quantiles).view(-1, 1, 1, 1)

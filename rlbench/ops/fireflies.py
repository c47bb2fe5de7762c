"""Firefly limit: a value far brighter than all pixels around it is dimmed before it spreads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.color import luminance
from rlbench.ops.exposure import MIDDLE_GREY, autoexposure
from rlbench.ops.sanitize import sanitize_radiance

__all__ = ["limit_fireflies", "limit_sample_fireflies"]

RADIUS = 2  # pixels around a pixel that vouch for its brightness
CONTRAST = 64.0  # times the brightest of them, above which a value is taken for an outlier


def limit_fireflies(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Finite linear radiance without outliers, which get the mean luminance of their window.

    An outlier exceeds 64 times the luminance of each other pixel in 5 x 5, and 64 times the
    log-average luminance of the image (as autoexposure takes it), so that a lamp in the dark is
    none. Renderers clamp samples to a constant (Cycles: "clamp indirect"); this limit follows the
    exposure of the scene, and leaves usual fireflies alone. Values that are not finite or negative
    are replaced first (rlbench.ops.sanitize).

    >>> radiance = torch.ones(1, 3, 5, 5)
    >>> radiance[..., 2, 2] = 65504.0
    >>> round(limit_fireflies(radiance)[0, 0, 2, 2].item(), 3)
    1.0
    """
    radiance = sanitize_radiance(radiance)
    return _replace_outliers(radiance, radiance)


def limit_sample_fireflies(
    radiance: Float[Tensor, "n s 3 h w"], counts: Int[Tensor, "n 1 h w"]
) -> Float[Tensor, "n s 3 h w"]:
    """As `limit_fireflies`, for single samples, compared with the means of the pixels around.

    `counts` is the number of samples per pixel; slots without a sample hold zero.
    """
    radiance = sanitize_radiance(radiance)
    return _replace_outliers(radiance, radiance.sum(1) / counts.clamp_min(1))


def _replace_outliers(
    radiance: Float[Tensor, "*n 3 h w"], mean: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "*n 3 h w"]:
    light, average = luminance(mean), MIDDLE_GREY / autoexposure(mean)
    brightest = torch.maximum(_max_of_neighbours(light), average)
    value = luminance(radiance)
    slots = (light.shape[0], *(1,) * (radiance.dim() - 4), *light.shape[1:])
    is_outlier = value > CONTRAST * brightest.view(slots)
    if not is_outlier.any():
        return radiance
    replacement = _window_mean(torch.minimum(light, brightest)).view(slots)
    return torch.where(is_outlier, radiance * (replacement / value.clamp_min(1e-30)), radiance)


def _max_of_neighbours(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The largest value of the window without its centre; beyond the border there is none."""
    h, w = light.shape[-2:]
    padded = F.pad(light, (RADIUS,) * 4)
    offsets = range(2 * RADIUS + 1)
    beside = [padded[..., x : x + w] for x in offsets if x != RADIUS]
    row = _largest([*beside, padded[..., RADIUS : RADIUS + w]])
    others = [row[..., y : y + h, :] for y in offsets if y != RADIUS]
    return _largest([*others, _largest(beside)[..., RADIUS : RADIUS + h, :]])


def _window_mean(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The mean over 5 x 5 pixels, of those inside the image."""
    return F.avg_pool2d(light, 2 * RADIUS + 1, 1, RADIUS, count_include_pad=False)


def _largest(images: Sequence[Tensor]) -> Tensor:
    return reduce(torch.maximum, images)

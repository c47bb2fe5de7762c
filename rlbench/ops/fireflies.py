"""Fireflies: a sample far brighter than all pixels around it is dimmed before it spreads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.color import luminance
from rlbench.ops.exposure import MIDDLE_GREY, autoexposure
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.transfer import HALF_MAX

__all__ = [
    "limit_fireflies",
    "mean_without_fireflies",
    "repair_moments",
    "repair_radiance_history",
]

RADIUS = 2  # pixels around a pixel that vouch for its brightness
CONTRAST = 64.0  # times the brightest of them, above which a sample is taken for an outlier
FALLOFF = 4  # an outlier twice as bright keeps 1/16 of the limit: no jump between kept and replaced
HISTORY_CONTRAST = 4096.0  # times the image's log-average, above which history is broken


def limit_fireflies(
    radiance: Float[Tensor, "n s 3 h w"], counts: Int[Tensor, "n 1 h w"]
) -> Float[Tensor, "n s 3 h w"]:
    """Finite samples without outliers, which are dimmed to the mean luminance around them.

    A sample is an outlier if its luminance exceeds 64 times the mean of each other pixel in 5 x 5,
    and 64 times the log-average luminance of the image, as autoexposure takes it. The farther it
    exceeds this limit, the closer it comes to the mean of its window. Renderers clamp
    samples to a constant (Cycles: "clamp indirect"); this limit follows the exposure of the scene
    and leaves usual fireflies alone. A lamp that covers a single pixel is dimmed like an outlier.
    Samples that are not finite or negative are replaced first (rlbench.ops.sanitize).

    `counts` is the number of samples per pixel; slots without a sample hold zero.

    >>> radiance = torch.ones(1, 1, 3, 5, 5)
    >>> radiance[..., 2, 2] = 65504.0
    >>> limited = limit_fireflies(radiance, counts=torch.ones(1, 1, 5, 5))
    >>> round(limited[0, 0, 0, 2, 2].item(), 3)
    1.0
    """
    return _limit(radiance, counts)[0]


def _limit(radiance: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """`limit_fireflies`, and the mean of each pixel's limited samples."""
    mean = _mean(radiance, counts)
    if sanitize_radiance(mean) is not mean:
        radiance = sanitize_radiance(radiance)
        mean = _mean(radiance, counts)
    light = luminance(mean)
    neighbours = _max_of_neighbours(light)
    brightest = torch.maximum(neighbours, _log_average(torch.minimum(light, neighbours)))
    suspects = light * counts > CONTRAST * brightest  # no sample is brighter than the sum
    if not suspects.any():
        return radiance, mean
    image, _, y, x = suspects.nonzero(as_tuple=True)
    pixels = (image, slice(None), y, x)
    limit = CONTRAST * brightest[pixels].view(-1, 1, 1, 1, 1)
    window = _window_mean(torch.minimum(light, brightest))
    replacement = window[pixels].view(-1, 1, 1, 1, 1)
    samples = radiance.movedim((3, 4), (1, 2))[image, y, x][..., None, None]  # k s 3 1 1
    value = luminance(samples)
    excess = (value / limit).clamp_min(1)
    dimmed = replacement + (limit - replacement) * excess.pow(-FALLOFF)
    limited = torch.where(excess > 1, samples * (dimmed / value.clamp_min(1e-30)), samples)
    radiance, mean = radiance.clone(), mean.clone()
    radiance.movedim((3, 4), (1, 2))[image, y, x] = limited[..., 0, 0]
    mean[pixels] = limited.sum(1)[..., 0, 0] / counts[pixels].clamp_min(1)
    return radiance, mean


def mean_without_fireflies(
    radiance: Float[Tensor, "n s 3 h w"], counts: Int[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 3 h w"]:
    """The mean of each pixel's samples after `limit_fireflies`; zero without a sample."""
    return _limit(radiance, counts)[1]


def repair_radiance_history(history: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Linear radiance of earlier frames, in which a broken pixel equals a neighbour.

    A pixel is broken if it is not finite, negative, or above 4096 times the log-average luminance.
    """
    return _repair_radiance(history)[0]


def repair_moments(
    mean: Float[Tensor, "n 3 h w"], second_moment: Float[Tensor, "n 1 h w"]
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 h w"]]:
    """Mean and second moment of earlier frames, in which a broken pixel equals a neighbour.

    The mean is repaired by `repair_radiance_history`. Samples in [0, x] have a second moment of
    luminance of at most x times their mean. A second moment is broken if it is not finite,
    negative, or above this limit, where x is 4096 times the log-average luminance. The average is
    added to the mean, because reprojection mixes pixels.
    """
    mean, average = _repair_radiance(mean)
    most = HISTORY_CONTRAST * average * (luminance(mean) + average)
    return mean, repair_history(second_moment, 0.0, most)


def _repair_radiance(history: Tensor) -> tuple[Tensor, Tensor]:
    """`repair_radiance_history`, and the log-average luminance of each image [n 1 1 1]."""
    history = repair_history(history, 0.0, HALF_MAX)
    light = luminance(history)
    average = _log_average(torch.minimum(light, _max_of_neighbours(light)))
    return repair_history(history, 0.0, HISTORY_CONTRAST * average), average


def _log_average(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 1 1"]:
    """The log-average luminance of each image, 0.18 for a black one."""
    return MIDDLE_GREY / autoexposure(light.expand(-1, 3, -1, -1))


def _mean(radiance: Tensor, counts: Tensor) -> Tensor:
    return radiance.sum(1) / counts.clamp_min(1)


def _max_of_neighbours(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The largest value of the window without its centre; beyond the border there is none."""
    h, w = light.shape[-2:]
    padded = F.pad(light, (RADIUS,) * 4)
    offsets = range(2 * RADIUS + 1)
    columns = [padded[..., x : x + w] for x in offsets if x != RADIUS]
    row = _largest([*columns, padded[..., RADIUS : RADIUS + w]])
    others = [row[..., y : y + h, :] for y in offsets if y != RADIUS]
    return _largest([*others, _largest(columns)[..., RADIUS : RADIUS + h, :]])


def _window_mean(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The mean over 5 x 5 pixels, of those inside the image."""
    return F.avg_pool2d(light, 2 * RADIUS + 1, 1, RADIUS, count_include_pad=False)


def _largest(images: Sequence[Tensor]) -> Tensor:
    return reduce(torch.maximum, images)

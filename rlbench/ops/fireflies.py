"""Fireflies: a sample far brighter than all pixels around it is dimmed before it spreads."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from rlbench.ops.asking import may_ask
from rlbench.ops.box_filter import box_mean
from rlbench.ops.color import luminance
from rlbench.ops.exposure import log_average
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.transfer import HALF_MAX
from rlbench.ops.windows import max_of_neighbours, window_sum

__all__ = [
    "limit_fireflies",
    "mean_without_fireflies",
    "repair_light",
    "repair_radiance_history",
]

RADIUS, MAX_RADIUS = 2, 20  # pixels around a pixel that vouch for its brightness
CONTRAST = 64.0  # times the brightest of them, above which a sample is taken for an outlier
FALLOFF = 4  # an outlier twice as bright keeps 1/16 of the limit: no jump between kept and replaced
NO_PIXEL = -1.0  # luminance where there is no sample, or no pixel: less than any
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
    Pixels without a sample count in no mean, and where there are many of them, the window grows, to
    at most 41 x 41, until it holds as many samples as 5 x 5 full pixels.
    Samples should be finite and not negative, as the suite hands them over. Where a pixel's mean is
    not, all samples are replaced first (rlbench.ops.sanitize); a negative sample that the others of
    its pixel outweigh stays.

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
    limit = _limit_suspects if may_ask(radiance) else _limit_everywhere
    return limit(radiance, counts)


def _limit_suspects(radiance: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """`_limit`, which works on pixels with an outlier alone."""
    known = counts > 0
    radii = _window_radius(known).flatten().tolist()
    if len(set(radii)) > 1:
        images = [_limit(radiance[i : i + 1], counts[i : i + 1]) for i in range(len(radii))]
        return torch.cat([each for each, _ in images]), torch.cat([each for _, each in images])
    mean, radius = _mean(radiance, counts), radii[0]
    if sanitize_radiance(mean) is not mean:
        radiance = _repair_samples(radiance, mean)
        mean = _mean(radiance, counts)
    light, brightest = _find_brightest(mean, known, radius)
    suspects = light * counts > CONTRAST * brightest  # no sample is brighter than the sum
    if not suspects.any():
        return radiance, mean
    image, _, y, x = suspects.nonzero(as_tuple=True)
    pixels = (image, slice(None), y, x)
    limit = CONTRAST * brightest[pixels].view(-1, 1, 1, 1, 1)
    side = 2 * radius + 1
    sums = [box_mean(x, side, "constant") for x in (torch.minimum(light, brightest), known.float())]
    light_around, known_around = (each[pixels].view(-1, 1, 1, 1, 1) for each in sums)
    replacement = light_around / known_around  # at least one sample where there is a suspect
    samples = radiance.movedim((3, 4), (1, 2))[image, y, x][..., None, None]  # k s 3 1 1
    limited = _dim(samples, limit, replacement)
    radiance, mean = radiance.clone(), mean.clone()
    radiance.movedim((3, 4), (1, 2))[image, y, x] = limited[..., 0, 0]
    mean[pixels] = limited.sum(1)[..., 0, 0] / counts[pixels].clamp_min(1)
    return radiance, mean


def _limit_everywhere(radiance: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """`_limit` without a question: every sample is computed, and those of suspects are taken."""
    known = counts > 0
    radius = _window_radius(known)
    radiance = _repair_samples(radiance, _mean(radiance, counts))
    mean = _mean(radiance, counts)
    light, brightest = _find_brightest(mean, known, radius)
    suspects = light * counts > CONTRAST * brightest
    parts = (torch.minimum(light, brightest), known.to(light.dtype))
    light_around, known_around = window_sum(torch.cat(parts, 1), radius).chunk(2, 1)
    replacement = light_around / known_around.clamp_min(1)
    dimmed = _dim(radiance, CONTRAST * brightest[:, None], replacement[:, None])
    limited = torch.where(suspects[:, None], dimmed, radiance)
    return limited, torch.where(suspects, _mean(limited, counts), mean)


def _repair_samples(radiance: Tensor, mean: Tensor) -> Tensor:
    """The samples; replaced by the rules for radiance in an image where a mean is not valid."""
    valid = ((mean >= 0) & (mean <= HALF_MAX)).flatten(1).all(1)  # False for NaN
    return radiance.where(valid.view(-1, 1, 1, 1, 1), sanitize_radiance(radiance))


def _find_brightest(mean: Tensor, known: Tensor, radius: int | Tensor) -> tuple[Tensor, Tensor]:
    """Luminance, and what vouches for it: the brightest neighbour, or the image's log-average."""
    light = luminance(mean)
    masked = light.where(known, NO_PIXEL)
    neighbours = max_of_neighbours(masked, radius, MAX_RADIUS, NO_PIXEL)
    plausible = torch.minimum(light, neighbours).where(neighbours >= 0, light)
    return light, torch.maximum(neighbours, log_average(plausible, known))


def _dim(samples: Tensor, limit: Tensor, replacement: Tensor) -> Tensor:
    """Samples [... 3 h w] above the limit, dimmed towards the luminance that replaces theirs."""
    value = luminance(samples)
    excess = (value / limit).clamp_min(1)
    dimmed = replacement + (limit - replacement) * excess.pow(-FALLOFF)
    divisor = value.where(excess > 1, 1.0)  # black samples would make the gradient 0 / 0
    return torch.where(excess > 1, samples * (dimmed / divisor), samples)


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


def repair_light(
    mean: Float[Tensor, "n 3 h w"],
    second_moment: Float[Tensor, "n 1 h w"],
    image: Float[Tensor, "n 3 h w"],
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 h w"], Float[Tensor, "n 3 h w"]]:
    """Mean, second moment and image of earlier frames; a broken pixel equals a neighbour.

    Mean and image are repaired by `repair_radiance_history`. Samples in [0, x] have a second moment
    of luminance of at most x times their mean. A second moment is broken if it is not finite,
    negative, or above this limit, where x is 4096 times the log-average luminance. The average is
    added to the mean, because reprojection mixes pixels.
    """
    repaired, averages = _repair_radiance(torch.cat((mean, image)))  # one call takes less time
    (mean, image), average = repaired.chunk(2), averages[: len(mean)]
    most = HISTORY_CONTRAST * average * (luminance(mean) + average)
    return mean, repair_history(second_moment, 0.0, most), image


def _repair_radiance(history: Tensor) -> tuple[Tensor, Tensor]:
    """`repair_radiance_history`, and the log-average luminance of each image [n 1 1 1]."""
    history = repair_history(history, 0.0, HALF_MAX)
    light = luminance(history)
    neighbours = max_of_neighbours(light, RADIUS, RADIUS, NO_PIXEL)
    plausible = torch.minimum(light, neighbours).where(neighbours >= 0, light)
    average = log_average(plausible)
    return repair_history(history, 0.0, HISTORY_CONTRAST * average), average


def _mean(radiance: Tensor, counts: Tensor) -> Tensor:
    return radiance.sum(1) / counts.clamp_min(1)


def _window_radius(known: Bool[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 1 1"]:
    """The radius of a window with as many samples as one of RADIUS in a full image has."""
    share = known.float().mean((1, 2, 3), keepdim=True).double()
    return (RADIUS / share.clamp_min((RADIUS / MAX_RADIUS) ** 2).sqrt()).round().long()

"""Firefly limit: a pixel much brighter than all of its neighbours is dimmed before it spreads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.color import luminance
from rlbench.ops.exposure import MIDDLE_GREY, autoexposure
from rlbench.ops.sanitize import sanitize_radiance

__all__ = ["FireflyLimit", "firefly_limit", "limit_fireflies"]

RADIUS = 2  # pixels around a pixel that vouch for its brightness
CONTRAST = 64.0  # times the brightest of them, above which a value is taken for an outlier


class FireflyLimit(NamedTuple):
    """The largest plausible luminance of each pixel, and what replaces a larger one."""

    largest: Float[Tensor, "n 1 h w"]
    replacement: Float[Tensor, "n 1 h w"]

    def apply(self, radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
        """Linear radiance, scaled to the replacement where it is too bright; the colour stays."""
        light = luminance(radiance)
        is_outlier = light > self.largest
        if not is_outlier.any():
            return radiance
        return torch.where(is_outlier, radiance * (self.replacement / light), radiance)


def limit_fireflies(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Finite linear radiance without outliers, by `firefly_limit`.

    Values that are not finite or negative are replaced first (rlbench.ops.sanitize).

    >>> radiance = torch.ones(1, 3, 5, 5)
    >>> radiance[..., 2, 2] = 65504.0
    >>> round(limit_fireflies(radiance)[0, 0, 2, 2].item(), 3)
    1.0
    """
    radiance = sanitize_radiance(radiance)
    return firefly_limit(radiance).apply(radiance)


def firefly_limit(radiance: Float[Tensor, "n 3 h w"]) -> FireflyLimit:
    """Outliers exceed 64 times the brightest of the other pixels in 5 x 5, which replaces them.

    In the dark, the log-average luminance of the image takes the place of the brightest pixel, as
    in autoexposure, so that a small lamp is not an outlier. `radiance` is linear, finite and >= 0.
    Renderers clamp samples to a constant (Cycles: "clamp indirect"); this limit follows the
    exposure of the scene, and leaves bright surfaces of two pixels and usual fireflies alone.
    """
    average = MIDDLE_GREY / autoexposure(radiance)
    brightest = torch.maximum(_max_of_neighbours(luminance(radiance)), average)
    return FireflyLimit(CONTRAST * brightest, brightest)


def _max_of_neighbours(light: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The largest value of the window without its centre; beyond the border there is none."""
    h, w = light.shape[-2:]
    padded = F.pad(light, (RADIUS,) * 4)
    offsets = range(2 * RADIUS + 1)
    beside = [padded[..., x : x + w] for x in offsets if x != RADIUS]
    row = _largest([*beside, padded[..., RADIUS : RADIUS + w]])
    others = [row[..., y : y + h, :] for y in offsets if y != RADIUS]
    return _largest([*others, _largest(beside)[..., RADIUS : RADIUS + h, :]])


def _largest(images: Sequence[Tensor]) -> Tensor:
    return reduce(torch.maximum, images)

"""History of accumulated radiance: repaired and reprojected, weighted by surface, static pixels."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.ops.accumulation import AccumulatedRadiance
from rlbench.ops.fireflies import repair_light
from rlbench.ops.reprojection import reproject_bicubic
from rlbench.ops.sanitize import repair_history
from rlbench.ops.transfer import log_forward

__all__ = ["find_static_pixels", "repair_spp", "reproject_radiance", "weigh_by_similarity"]

MAX_SPP = 1e4  # accumulated samples; a larger number is not a count
MIN_WEIGHT = 1e-3  # samples; a smaller weight is that of another surface, and underflow decides
STATIC_MOTION = 1e-3  # pixels; a smaller motion counts as none
SAME_SURFACE = 0.5  # least similarity, in [0, 1], of one surface in two frames
CHANNELS = [3, 1, 3]  # mean, second moment, image


def repair_spp(spp: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Accumulated samples per pixel, in which a pixel that holds no count equals a neighbour."""
    return repair_history(spp, 0.0, MAX_SPP)


def reproject_radiance(
    radiance: AccumulatedRadiance,
    image: Float[Tensor, "n 3 h w"],
    motion: Float[Tensor, "n 2 h w"] | None,
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 h w"], Float[Tensor, "n 3 h w"]]:
    """Mean, second moment, and the previous image in log transfer, by bicubic taps.

    `image` is linear. It is reprojected in log transfer, since linear bicubic taps next to a lamp
    are dominated by rounding errors.
    """
    mean, square, image = repair_light(radiance.mean, radiance.second_moment, image)
    moved, _ = reproject_bicubic(torch.cat((mean, square, log_forward(image)), dim=1), motion)
    mean, square, image = moved.split_with_sizes(CHANNELS, 1)
    return mean, square, image


def weigh_by_similarity(
    spp: Float[Tensor, "n 1 h w"], similarity: Float[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The weight of the history in samples: less on other surfaces, and none below 0.001."""
    weight = spp * similarity
    return weight.where(weight > MIN_WEIGHT, 0.0)


def find_static_pixels(
    similarity: Float[Tensor, "n 1 h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> Bool[Tensor, "n 1 h w"]:
    """True where the same surface did not move; `similarity` is 0 where there is no history."""
    static = similarity > SAME_SURFACE
    if motion is None:
        return static
    return static & (motion.abs().amax(1, keepdim=True) < STATIC_MOTION)

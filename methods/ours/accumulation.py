"""Light gathered over frames: a running mean of all samples that a pixel got, and its spread."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.frames import Samples
from rlbench.ops.color import luminance
from rlbench.ops.demodulation import demodulation_albedo
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import log_forward

LEVELS = 5  # of the pyramid that holes are filled from: 1/2 to 1/32
UNLIKE = 2.0  # how fast trust falls with a difference of normal and albedo, summed
FARTHER = 5.0  # and with a relative difference of depth
MUCH = 16.0  # samples that a weight is compared with where networks see it


class AccumulatedRadiance(NamedTuple):
    """What is known of a pixel's light, as if `weight` samples had been averaged."""

    mean: Float[Tensor, "n 3 h w"]  # linear radiance
    second_moment: Float[Tensor, "n 1 h w"]  # of the luminance
    accumulated_spp: Float[Tensor, "n 1 h w"]  # samples

    @property
    def variance(self) -> Float[Tensor, "n 1 h w"]:
        """Of one sample's luminance."""
        return (self.second_moment - luminance(self.mean).square()).clamp_min(0)


def frame_radiance(samples: Samples) -> AccumulatedRadiance:
    """The light of the samples of one frame, which are finite."""
    weight = samples.counts.to(samples.radiance.dtype)
    square = luminance(samples.radiance).square().sum(1) / weight.clamp_min(1)
    return AccumulatedRadiance(samples.mean, square, weight)


def accumulate(
    old: AccumulatedRadiance, new: AccumulatedRadiance, trust: Float[Tensor, "n 1 h w"]
) -> AccumulatedRadiance:
    """Both together; of the old weight only the share `trust` (in [0, 1]) is kept."""
    held = old.accumulated_spp * trust
    weight = held + new.accumulated_spp
    share = held / weight.clamp_min(1e-6)
    mean, square = (torch.lerp(b, a, share) for a, b in zip(old[:2], new[:2], strict=True))
    return AccumulatedRadiance(mean, square, weight)


def feature_similarity(
    seen: Float[Tensor, "n 7 h w"], before: Float[Tensor, "n 7 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """How much normal, albedo and depth (1 / (1 + z)) are those of the last frame, in [0, 1]."""
    surface = (seen[:, :6] - before[:, :6]).abs().sum(1, keepdim=True)
    depth = (seen[:, 6:] - before[:, 6:]).abs() / (seen[:, 6:] + 1e-3)
    return torch.exp(-UNLIKE * surface - FARTHER * depth)


def network_features(light: AccumulatedRadiance) -> Float[Tensor, "n 5 h w"]:
    """What networks see of it: colour in log transfer, relative spread and weight in [0, 1)."""
    spread = light.variance.clamp_min(1e-8).sqrt()
    relative = spread / (spread + luminance(light.mean) + 1e-3)
    return torch.cat(
        (log_forward(light.mean), relative, light.accumulated_spp / (light.accumulated_spp + MUCH)),
        1,
    )


def fill_holes(light: AccumulatedRadiance, albedo: Float[Tensor, "n 3 h w"]) -> AccumulatedRadiance:
    """The same, and where there is no weight the colour of the neighbourhood, textured by albedo.

    A pyramid of weighted means of light without albedo; a hole takes the finest level that has any.
    What is moved has to be filled: taps would mix black into whatever lies beside a hole.
    """
    h, w = albedo.shape[-2:]
    texture = demodulation_albedo(albedo.clamp(0, 1))
    each = torch.cat((light.mean / texture * light.accumulated_spp, light.accumulated_spp), 1)
    levels = [pad(each, 2**LEVELS)]
    for _ in range(LEVELS):
        levels.append(F.avg_pool2d(levels[-1], 2))
    levels.append(levels[-1].mean((2, 3), keepdim=True))
    below = _mean(levels.pop())
    for level in reversed(levels[1:]):
        rough = F.interpolate(below, size=level.shape[-2:], mode="bilinear")
        below = torch.where(level[:, 3:] > 0, _mean(level), rough)
    rough = crop(F.interpolate(below, scale_factor=2.0, mode="bilinear"), h, w)
    known = light.accumulated_spp > 0
    mean = torch.where(known, light.mean, rough * texture)
    return AccumulatedRadiance(
        mean,
        torch.where(known, light.second_moment, luminance(mean).square()),
        light.accumulated_spp,
    )


def _mean(level: Tensor) -> Tensor:
    return level[:, :3] / level[:, 3:].clamp_min(1e-6)

"""Accumulated radiance: a running mean of all samples of a pixel, with its second moment."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.asking import may_ask
from rlbench.ops.box_filter import block_mean
from rlbench.ops.color import luminance
from rlbench.ops.demodulation import demodulation_albedo
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import squash_depth

__all__ = [
    "AccumulatedRadiance",
    "accumulate",
    "feature_similarity",
    "fill_holes",
    "frame_radiance",
    "is_cut",
    "surface_features",
]

LEAST_SPP = 1e-6  # a weight below it counts as none
PYRAMID_LEVELS = 5  # of the pyramid that holes are filled from: 1/2 to 1/32
SURFACE_FALLOFF = 0.25  # of history, per difference of normal and albedo, summed over channels
DEPTH_FALLOFF = 5.0  # of similarity, per relative difference of depth
# a cut: in more than this share of blocks, the mean normal and albedo differ by more than that
CUT_SHARE, CUT_DIFFERENCE, CUT_BLOCK = 1 / 3, 0.3, 8


class AccumulatedRadiance(NamedTuple):
    """Radiance of each pixel, as if `accumulated_spp` samples had been averaged."""

    mean: Float[Tensor, "n 3 h w"]  # linear radiance
    second_moment: Float[Tensor, "n 1 h w"]  # of the luminance
    accumulated_spp: Float[Tensor, "n 1 h w"]  # samples, a real number: the weight of the mean

    @property
    def variance(self) -> Float[Tensor, "n 1 h w"]:
        """Variance of the luminance of one sample."""
        return (self.second_moment - luminance(self.mean).square()).clamp_min(0)

    def scale_weight(self, factor: Float[Tensor, "n 1 h w"]) -> AccumulatedRadiance:
        """The same radiance, as if it came from `factor` times as many samples."""
        return self._replace(accumulated_spp=self.accumulated_spp * factor)


def frame_radiance(
    radiance: Float[Tensor, "n s 3 h w"], counts: Int[Tensor, "n 1 h w"]
) -> AccumulatedRadiance:
    """The radiance of one frame. Samples must be finite, and zero in slots without a sample."""
    spp = counts.to(radiance.dtype)
    mean, square = (
        values.sum(1) / spp.clamp_min(1) for values in (radiance, luminance(radiance).square())
    )
    return AccumulatedRadiance(mean, square, spp)


def accumulate(
    old: AccumulatedRadiance, new: AccumulatedRadiance, trust: Float[Tensor, "n 1 h w"]
) -> AccumulatedRadiance:
    """The weighted mean of both. The old weight is first multiplied by `trust`, in [0, 1].

    An old weight below LEAST_SPP counts as none: a pixel without a new sample is a hole then.
    """
    old_spp = old.accumulated_spp * trust
    old_spp = old_spp.where(old_spp >= LEAST_SPP, 0.0)
    spp = old_spp + new.accumulated_spp
    share = old_spp / spp.clamp_min(LEAST_SPP)
    mean, square = (torch.lerp(b, a, share) for a, b in zip(old[:2], new[:2], strict=True))
    return AccumulatedRadiance(mean, square, spp)


def surface_features(
    normal: Float[Tensor, "n 3 h w"],
    albedo: Float[Tensor, "n 3 h w"],
    depth: Float[Tensor, "n 1 h w"],
) -> Float[Tensor, "n 7 h w"]:
    """What identifies a surface: normal, albedo, 1 / (1 + depth)."""
    return torch.cat((normal, albedo, squash_depth(depth)), dim=1)


def feature_similarity(
    current: Float[Tensor, "n 7 h w"],
    previous: Float[Tensor, "n 7 h w"],
    surface_falloff: float | None = None,
) -> Float[Tensor, "n 1 h w"]:
    """Similarity of two G-buffers, in [0, 1]: 1 where normal, albedo and depth are the same.

    Channels are those of `surface_features`. `surface_falloff` is SURFACE_FALLOFF unless given.
    """
    falloff = SURFACE_FALLOFF if surface_falloff is None else surface_falloff
    surface = (current[:, :6] - previous[:, :6]).abs().sum(1, keepdim=True)
    depth = (current[:, 6:] - previous[:, 6:]).abs() / (current[:, 6:] + 1e-3)
    return torch.exp(-falloff * surface - DEPTH_FALLOFF * depth)


def is_cut(
    current: Float[Tensor, "n 7 h w"],
    previous: Float[Tensor, "n 7 h w"],
    valid: Bool[Tensor, "n 1 h w"],
) -> Bool[Tensor, "n 1 1 1"]:
    """True if an image shows another place than the last one, though its motion does not say so.

    Channels are those of `surface_features`; `previous` is reprojected, and counts where `valid`.
    Blocks of 8 x 8 pixels, most of them valid, are compared by their means, so that noise of the
    buffers is not a cut. On clips without cuts at most 0.15 of the blocks differ, and at least 0.5
    after a cut (docs/development.md).
    """
    weight = pad(valid.to(current.dtype), CUT_BLOCK)
    change = pad(current[:, :6] - previous[:, :6], CUT_BLOCK) * weight
    valid_share = block_mean(weight, CUT_BLOCK)
    difference = block_mean(change, CUT_BLOCK).abs().sum(1, keepdim=True)
    compared = valid_share > 0.5
    differs = compared & (difference > CUT_DIFFERENCE * valid_share)
    blocks, changed = (mask.sum((2, 3), keepdim=True) for mask in (compared, differs))
    return changed > CUT_SHARE * blocks


def fill_holes(
    radiance: AccumulatedRadiance, albedo: Float[Tensor, "n 3 h w"]
) -> AccumulatedRadiance:
    """The radiance with pixels of weight 0 filled from their neighbourhood, textured by albedo.

    Weighted means of demodulated radiance form a pyramid; a hole takes the finest level that has
    any weight. Holes must be filled before reprojection: bilinear taps would mix black into the
    pixels beside a hole.
    """
    sampled = radiance.accumulated_spp > 0
    if may_ask(sampled) and sampled.all():
        return radiance
    h, w = albedo.shape[-2:]
    texture = demodulation_albedo(albedo.clamp(0, 1))
    weighted = torch.cat(
        (radiance.mean / texture * radiance.accumulated_spp, radiance.accumulated_spp), 1
    )
    levels = [pad(weighted, 2**PYRAMID_LEVELS)]
    for _ in range(PYRAMID_LEVELS):
        levels.append(block_mean(levels[-1], 2))
    levels.append(levels[-1].mean((2, 3), keepdim=True))
    coarse = _mean(levels.pop())
    for level in reversed(levels[1:]):
        upsampled = F.interpolate(coarse, size=level.shape[-2:], mode="bilinear")
        coarse = torch.where(level[:, 3:] > 0, _mean(level), upsampled)
    coarse = crop(F.interpolate(coarse, scale_factor=2.0, mode="bilinear"), h, w)
    mean = torch.where(sampled, radiance.mean, coarse * texture)
    square = torch.where(sampled, radiance.second_moment, luminance(mean).square())
    return AccumulatedRadiance(mean, square, radiance.accumulated_spp)


def _mean(level: Float[Tensor, "n 4 h w"]) -> Float[Tensor, "n 3 h w"]:
    return level[:, :3] / level[:, 3:].clamp_min(1e-6)

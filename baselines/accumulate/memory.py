"""The memory by rule: radiance of all frames and the last image, reprojected and rejected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.frames import GBuffer, Size
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    accumulate,
    feature_similarity,
    surface_features,
)
from rlbench.ops.antilag import history_confidence
from rlbench.ops.fireflies import repair_moments, repair_radiance_history
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.sanitize import repair_history
from rlbench.ops.transfer import log_forward

__all__ = ["History", "Memory", "accumulate_frame", "empty_memory", "reproject_memory"]

TRUST = 0.8  # share of the old weight that is kept: alpha of 0.2 (Schied et al. 2017)
SPARSE_WEIGHT = 1e-3  # samples; a smaller weight is that of another surface
MAX_SPP = 1e4  # accumulated samples; a larger number is no count
MAX_CHANGE = 4.0  # of an image in log transfer, squared; a larger number is no change
STATIC_MOTION = 1e-3  # pixels; a smaller motion counts as none
SAME_SURFACE = 0.5  # least similarity, in [0, 1], of one surface in two frames


@dataclass(frozen=True, eq=False)
class Memory:
    """What is carried from one frame to the next, at the pixels of the earlier frame."""

    radiance: AccumulatedRadiance
    image: Float[Tensor, "n 3 h w"]  # last output, linear radiance
    change: Float[Tensor, "n 1 h w"]  # mean square of the denoised image's change between frames
    surface: Float[Tensor, "n 7 h w"]  # `surface_features`
    age: int  # frames so far

    def detach(self) -> Memory:
        """The same memory, cut from the autograd graph."""
        radiance = AccumulatedRadiance(*(part.detach() for part in self.radiance))
        return replace(self, radiance=radiance, image=self.image.detach())


class History(NamedTuple):
    """The memory at the pixels of the current frame."""

    radiance: AccumulatedRadiance  # weight 0 where there is no history
    image: Float[Tensor, "n 3 h w"]  # last output, log transfer
    change: Float[Tensor, "n 1 h w"]
    similarity: Float[Tensor, "n 1 h w"]  # of surfaces before and now, in [0, 1]
    static_mask: Bool[Tensor, "n 1 h w"]  # True where the same surface did not move

    def with_confidence(self, confidence: Float[Tensor, "n 1 h w"]) -> History:
        """The history with its weight and similarity multiplied by a confidence in [0, 1]."""
        spp = self.radiance.accumulated_spp * confidence
        radiance = self.radiance._replace(accumulated_spp=spp)
        return self._replace(radiance=radiance, similarity=self.similarity * confidence)


def empty_memory(size: Size, device: torch.device) -> Memory:
    """The memory before the first frame."""
    zero = torch.zeros(size.n, 1, size.h, size.w, device=device)
    black = zero.expand(-1, 3, -1, -1)
    surface = zero.expand(-1, 7, -1, -1)
    return Memory(AccumulatedRadiance(black, zero, zero), black, zero, surface, age=0)


def reproject_memory(gbuffer: GBuffer, memory: Memory) -> History:
    """The memory at the current pixels: radiance and image by bicubic taps, weights by bilinear."""
    bilinear = (
        repair_history(memory.radiance.accumulated_spp, 0.0, MAX_SPP),
        repair_history(memory.change, 0.0, MAX_CHANGE),
        repair_history(memory.surface, -1.1, 1.1),
    )
    moved, valid = reproject(torch.cat(bilinear, dim=1), gbuffer.motion)
    spp, change, surface = moved.split_with_sizes([1, 1, 7], dim=1)
    bicubic = (
        *repair_moments(memory.radiance.mean, memory.radiance.second_moment),
        log_forward(repair_radiance_history(memory.image)),
    )
    sharp, _ = reproject_bicubic(torch.cat(bicubic, dim=1), gbuffer.motion)
    mean, square, image = sharp.split_with_sizes([3, 1, 3], dim=1)

    current = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
    valid = valid & (memory.age > 0)
    similarity = feature_similarity(current, surface).where(valid, 0.0)
    weight = spp * similarity
    radiance = AccumulatedRadiance(mean, square, weight.where(weight > SPARSE_WEIGHT, 0.0))
    static = similarity > SAME_SURFACE
    if gbuffer.motion is not None:
        static = static & (gbuffer.motion.abs().amax(1, keepdim=True) < STATIC_MOTION)
    return History(radiance, image, change, similarity, static)


def accumulate_frame(
    history: History, current: AccumulatedRadiance
) -> tuple[AccumulatedRadiance, History]:
    """The radiance up to this frame, and the history that new samples do not contradict.

    The old weight is multiplied by 0.8, so that old light fades; where nothing moves it is kept, so
    that a still camera converges.
    """
    history = history.with_confidence(history_confidence(history.radiance, current, history.image))
    trust = torch.full_like(history.similarity, TRUST).masked_fill(history.static_mask, 1.0)
    return accumulate(history.radiance, current, trust), history

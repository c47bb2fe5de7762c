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
from rlbench.ops.radiance_history import (
    find_static_pixels,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from rlbench.ops.reprojection import reproject
from rlbench.ops.sanitize import repair_history

__all__ = [
    "History",
    "Memory",
    "accumulate_frame",
    "empty_memory",
    "reproject_memory",
    "trust_by_rule",
]

TRUST = 0.8  # share of the old weight that is kept: alpha of 0.2 (Schied et al. 2017)
MAX_CHANGE = 4.0  # of an image in log transfer, squared; a larger number is no change


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
        radiance = self.radiance.scale_weight(confidence)
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
        repair_spp(memory.radiance.accumulated_spp),
        repair_history(memory.change, 0.0, MAX_CHANGE),
        repair_history(memory.surface, -1.1, 1.1),
    )
    moved, valid = reproject(torch.cat(bilinear, dim=1), gbuffer.motion)
    spp, change, surface = moved.split_with_sizes([1, 1, 7], dim=1)
    mean, square, image = reproject_radiance(memory.radiance, memory.image, gbuffer.motion)

    current = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
    valid = valid & (memory.age > 0)
    similarity = feature_similarity(current, surface).where(valid, 0.0)
    radiance = AccumulatedRadiance(mean, square, weigh_by_similarity(spp, similarity))
    static = find_static_pixels(similarity, gbuffer.motion)
    return History(radiance, image, change, similarity, static)


def accumulate_frame(
    history: History, current: AccumulatedRadiance
) -> tuple[AccumulatedRadiance, History]:
    """The radiance up to this frame, and the history that new samples do not contradict."""
    history = history.with_confidence(history_confidence(history.radiance, current, history.image))
    trust = trust_by_rule(history.static_mask)
    return accumulate(history.radiance, current, trust), history


def trust_by_rule(static_mask: Bool[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The factor on the weight of old radiance: 0.8, so that old light fades.

    It is 1 where nothing moves, so that a still camera converges.
    """
    return torch.where(static_mask, 1.0, TRUST)

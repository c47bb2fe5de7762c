"""The memory by rule: radiance of all frames and the last image, reprojected and rejected.

The variants `ntas/history`, `imcd/history` and `nppd/history` carry it beside their own state: it
decides how far that state's history holds, so that reprojection and rejection are those of
`accumulate` and `ours`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    accumulate,
    feature_similarity,
    fill_holes,
    frame_radiance,
    is_cut,
    surface_features,
)
from rlbench.ops.antilag import history_confidence
from rlbench.ops.asking import next_age
from rlbench.ops.fireflies import limit_fireflies, repair_radiance_history
from rlbench.ops.radiance_history import (
    find_static_pixels,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.sanitize import repair_history
from rlbench.ops.transfer import log_forward, log_inverse

TRUST = 0.8  # share of the old weight that is kept: alpha of 0.2 (Schied et al. 2017)
MAX_CHANGE = 4.0  # of an image in log transfer, squared; a larger number is no change
MAX_FEATURE = 1e4  # in magnitude; usual ones are below 100
MIN_WEIGHT = 1e-3  # a smaller weight is that of another surface or of other light


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
    valid = valid & ~is_cut(current, surface, valid)
    similarity = feature_similarity(current, surface).where(valid, 0.0)
    radiance = AccumulatedRadiance(mean, square, weigh_by_similarity(spp, similarity))
    static = find_static_pixels(similarity, gbuffer.motion)
    return History(radiance, image, change, similarity, static)


def accumulate_frame(
    history: History, current: AccumulatedRadiance, slot_spp: float = 1.0
) -> tuple[AccumulatedRadiance, History]:
    """The radiance up to this frame, and the history that new samples do not contradict.

    `slot_spp` is that of the samples: see `share_by_spp`.
    """
    history = history.with_confidence(history_confidence(history.radiance, current, history.image))
    trust = trust_by_rule(history.static_mask, share_by_spp(slot_spp))
    return accumulate(history.radiance, current, trust), history


def accumulate_samples(
    samples: Samples, history: History
) -> tuple[AccumulatedRadiance, AccumulatedRadiance, History]:
    """This frame's radiance without fireflies, and the result of `accumulate_frame` with it."""
    radiance = limit_fireflies(samples.radiance, samples.counts)
    current = frame_radiance(radiance, samples.counts)
    return current, *accumulate_frame(history, current, samples.slot_spp)


def share_by_spp(slot_spp: float) -> float:
    """The factor on the weight of history in frames of more samples than methods are trained on.

    What reprojection blurs and what light changes does not shrink with more samples, while noise
    does. The square root of the samples is a choice on clips of preset `development`; it is 1 for
    samples of the benchmark.
    """
    return 1 / math.sqrt(slot_spp)


def trust_by_rule(
    static_mask: Bool[Tensor, "n 1 h w"], share: float = 1.0
) -> Float[Tensor, "n 1 h w"]:
    """The factor on the weight of old radiance: 0.8 times `share`, so that old light fades.

    It is 1 where nothing moves, so that a still camera converges.
    """
    return torch.where(static_mask, 1.0, TRUST * share)


def surface_weight(history: History) -> Float[Tensor, "n 1 h w"]:
    """The weight of history in [0, 1] by similarity of surfaces; 0 below 0.001.

    It is 1 where normal, albedo and depth are those of the last frame, and 0 without history.
    """
    return history.similarity.where(history.similarity > MIN_WEIGHT, 0.0)


@torch.no_grad()
def weigh_history(
    gbuffer: GBuffer, samples: Samples, memory: Memory, history: History
) -> tuple[Float[Tensor, "n 1 h w"], Memory]:
    """The weight of history in [0, 1], similarity times antilag confidence, and the new memory.

    `history` is `memory` at the pixels of this frame. The new memory holds the samples and surfaces
    of this frame, but the last frame's image, which `with_image` replaces.
    """
    _, accumulated, history = accumulate_samples(samples, history)
    surface = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
    filled = fill_holes(accumulated, gbuffer.albedo)
    memory = replace(memory, radiance=filled, surface=surface, age=next_age(memory.age))
    return surface_weight(history), memory


def with_image(memory: Memory | None, image: Float[Tensor, "n 3 h w"]) -> Memory | None:
    """The memory with this image in linear radiance, without its graph; None stays None."""
    return memory and replace(memory, image=image.detach())


def reproject_image(
    image: Float[Tensor, "n 3 h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n 3 h w"], Bool[Tensor, "n 1 h w"]]:
    """As `reproject_bicubic`, for a linear image >= 0; taps are mixed in log transfer.

    In linear space a lamp would dominate the pixels beside it.
    """
    moved, valid = reproject_bicubic(log_forward(image), motion)
    return log_inverse(moved), valid


class LightHistory(NamedTuple):
    """The state of `imcd` and `nppd`: light and features that they accumulate, demodulated."""

    irradiance: Float[Tensor, "n 3 h w"]  # noisy, accumulated over frames
    denoised: Float[Tensor, "n 3 h w"]  # the previous image, linear
    features: Float[Tensor, "n c h w"]  # such as embeddings, accumulated over frames
    age: int  # frames so far; at 0 the images are meaningless
    memory: Memory | None = None  # that weighs the history; None: only its validity counts

    @classmethod
    def empty(cls, size: Size, features: int, device: torch.device, weighted: bool) -> LightHistory:
        """No history, with so many channels of features."""
        images = (torch.zeros(size.n, c, size.h, size.w, device=device) for c in (3, 3, features))
        return cls._make((*images, 0, empty_memory(size, device) if weighted else None))

    def detach(self) -> LightHistory:
        """The same state without the autograd graph."""
        return LightHistory._make((*(image.detach() for image in self[:3]), *self[3:]))

    def reproject(
        self, gbuffer: GBuffer, samples: Samples
    ) -> tuple[LightHistory, Float[Tensor, "n 1 h w"]]:
        """The state as seen from this frame, and its weight in [0, 1]; zero where it has none.

        Without a memory the weight is 1 where there is history, and all is moved by bilinear taps.
        With one it is `weigh_history`, and the memory of the result already holds this frame, but
        for the image. Light and image then move by bicubic taps: light linearly, since a mean in
        log transfer is too dark, the image as in `reproject_image`.
        """
        noisy, denoised = map(repair_radiance_history, self[:2])
        features = repair_history(self.features, -MAX_FEATURE, MAX_FEATURE)
        channels = (3, 3, features.shape[1])
        if self.memory is None:
            moved, valid = reproject(torch.cat((noisy, denoised, features), 1), gbuffer.motion)
            weight, memory = (valid & (self.age > 0)).to(moved.dtype), None
        else:
            weight, memory = weigh_history(
                gbuffer, samples, self.memory, reproject_memory(gbuffer, self.memory)
            )
            light, _ = reproject_bicubic(noisy, gbuffer.motion)
            image, _ = reproject_image(denoised, gbuffer.motion)
            moved = torch.cat((light, image, reproject(features, gbuffer.motion)[0]), 1)
        parts = moved.where(weight > 0, 0.0).split_with_sizes(channels, 1)
        return LightHistory._make((*parts, self.age, memory)), weight

"""Weighted history: the memory of `accumulate` decides how far another method's history holds.

The variants `ntas/history`, `imcd/history` and `nppd/history` share it. They carry the memory by
rule beside their own state, so that reprojection and rejection are those of `accumulate` and
`ours`.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.accumulate.memory import History, Memory, accumulate_frame
from rlbench.frames import GBuffer, Samples
from rlbench.ops.accumulation import fill_holes, frame_radiance, surface_features
from rlbench.ops.fireflies import limit_fireflies, repair_radiance_history
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.transfer import log_forward, log_inverse

__all__ = ["reproject_image", "reproject_images", "surface_weight", "weigh_history", "with_image"]

MIN_WEIGHT = 1e-3  # a smaller weight is that of another surface or of other light


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
    radiance = limit_fireflies(samples.radiance, samples.counts)
    current = frame_radiance(radiance, samples.counts)
    accumulated, history = accumulate_frame(history, current)
    surface = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
    filled = fill_holes(accumulated, gbuffer.albedo)
    memory = replace(memory, radiance=filled, surface=surface, age=memory.age + 1)
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


def reproject_images(
    noisy: Float[Tensor, "n 3 h w"],
    denoised: Float[Tensor, "n 3 h w"],
    features: Float[Tensor, "n c h w"],
    motion: Float[Tensor, "n 2 h w"] | None,
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 3 h w"], Float[Tensor, "n c h w"]]:
    """Noisy light, the denoised image and features, all as seen from the current frame.

    Light and image move by bicubic taps, features by bilinear ones. Light stays linear, since a
    mean in log transfer is too dark; the image moves as in `reproject_image`. Features must be
    finite. Pixels whose history lies outside the image hold arbitrary values.
    """
    mean, _ = reproject_bicubic(repair_radiance_history(noisy), motion)
    image, _ = reproject_image(repair_radiance_history(denoised), motion)
    return mean, image, reproject(features, motion)[0]

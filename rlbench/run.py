"""The page: one frame through one method. Training and benchmark both go through it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import Clip, Frame, Samples
from rlbench.method import Method, checked_density
from rlbench.sampling import draw_pilot, draw_samples


@dataclass(frozen=True)
class FrameResult:
    """What came of one frame: the image, and all samples that were bought for it."""

    frame: Frame
    samples: Samples
    image: Float[Tensor, "n 3 h w"]


def unroll(method: Method, clip: Clip, spp: float) -> Iterator[FrameResult]:
    """Send `clip` through `method`, frame by frame, at `spp` samples per pixel on average."""
    traits = method.traits
    state = method.start(clip.size)
    for frame in clip:
        gbuffer = frame.gbuffer.select(traits.inputs)
        samples = draw_pilot(frame.pool, min(traits.pilot_spp, spp))
        for share in traits.passes:
            density, before = checked_density(method, gbuffer, samples, state), samples
            poor = (
                share < 1 and spp * share < traits.min_samples
            )  # then no pixel is given more than it
            limits = (0, traits.min_samples) if poor else (traits.min_samples, traits.max_samples)
            samples = draw_samples(
                frame.pool, before, density, spp * share, *limits, traits.discard_pilot
            )
        kept = samples.since(before) if traits.discard_pilot else samples
        image, state = method.denoise(gbuffer, kept, state)
        yield FrameResult(frame, samples, image)


@torch.inference_mode()  # as a decorator it holds while a frame is made, not between frames
def run_clip(method: Method, clip: Clip, spp: float) -> Iterator[FrameResult]:
    """`unroll` without gradients, for measuring."""
    yield from unroll(method, clip, spp)

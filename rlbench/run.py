"""The page: one frame through one method. Training and benchmark both go through it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import Clip, Frame, Samples
from rlbench.method import Method, planned
from rlbench.sampling import buy, evenly


@dataclass(frozen=True)
class Shown:
    """What came of one frame: the image, and all samples that were bought for it."""

    frame: Frame
    samples: Samples
    image: Float[Tensor, "n 3 h w"]


def unroll(method: Method, clip: Clip, spp: float) -> Iterator[Shown]:
    """Send `clip` through `method`, frame by frame, at `spp` samples per pixel on average."""
    traits = method.traits
    state = method.start(clip.size)
    for frame in clip:
        view = frame.view.only(traits.needs)
        samples = evenly(frame.pool, min(traits.pilot, spp))
        for share in traits.passes:
            density, before = planned(method, view, samples, state), samples
            poor = share < 1 and spp * share < traits.floor  # then no pixel is given more than it
            limits = (0, traits.floor) if poor else (traits.floor, traits.cap)
            samples = buy(frame.pool, before, density, spp * share, *limits, traits.fresh)
        kept = samples.after(before) if traits.fresh else samples
        image, state = method.denoise(view, kept, state)
        yield Shown(frame, samples, image)


@torch.inference_mode()  # as a decorator it holds while a frame is made, not between frames
def run_clip(method: Method, clip: Clip, spp: float) -> Iterator[Shown]:
    """`unroll` without gradients, for measuring."""
    yield from unroll(method, clip, spp)

"""A long clip in a batch of two: a static camera, and a moving one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from rlbench.checks.frame_edits import join_clips
from rlbench.clips.in_memory import ComputedFrames, InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Size, StoredPool

__all__ = ["MOVING", "STATIC", "long_clip"]

STATIC, MOVING = 0, 1  # positions in the batch
SEED = 7100
SIDE = 16  # pixels: a frame of a network costs little more than its overhead
POOL_SPP = 8
SIGMA = 0.8  # standard deviation of the logarithm of a sample of the static clip


def long_clip(frames: int, device: torch.device) -> InMemoryClip:
    """A clip of `frames` frames, each computed when it is read, and freed after it.

    In clip 0 neither camera nor objects move, and motion is zero everywhere; in clip 1 both move.
    All frames of both have new noise. Differs from a clip of one static shot, whose motion is None,
    so that both can run as one batch.
    """
    computed = ComputedFrames(frames, _LongFrames(frames, device).join)
    return InMemoryClip("long", "procedural", "", computed)


@dataclass(frozen=True)
class _LongFrames:
    """Computes the frames of both clips of the batch."""

    length: int
    device: torch.device

    def join(self, index: int) -> Frame:
        """One frame of the static and of the moving clip, as a batch."""
        moving = self._moving[index]
        return join_clips([[self._static_frame(index, moving)], [moving]]).frames[0]

    @cached_property
    def _moving(self) -> Sequence[Frame]:
        size = Size(1, SIDE, SIDE)
        return procedural_clip(
            SEED + MOVING, size, self.length, POOL_SPP, device=self.device
        ).frames

    @cached_property
    def _static(self) -> Frame:
        size = Size(1, SIDE, SIDE)
        return procedural_clip(SEED, size, 1, 1, static=True, device=self.device).frames[0]

    def _static_frame(self, index: int, moving: Frame) -> Frame:
        """The static camera's frame: radiance times noise without the moving clip's fireflies.

        With them, the mean of 2,000 samples would still be far from the truth.
        """
        generator = torch.Generator().manual_seed(SEED + index)  # equal on every device
        z = torch.randn(1, POOL_SPP, 1, SIDE, SIDE, generator=generator).to(self.device)
        radiance = self._static.reference.mean[:, None] * torch.exp(SIGMA * z - SIGMA**2 / 2)
        seeds = tuple(seed + 1 for seed in moving.pool.rounding_seeds)
        motion = torch.zeros_like(moving.gbuffer.buffers["motion"])
        gbuffer = GBuffer({**self._static.gbuffer.buffers, "motion": motion})
        return Frame(index, gbuffer, StoredPool(radiance, seeds), self._static.reference)

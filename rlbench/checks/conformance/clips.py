"""Clips for the conformance checks: closed-form, in memory, shared by all methods."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import torch

from rlbench.checks.frame_edits import stored_radiance, to_clip
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool
from rlbench.run import FrameResult

EVEN_SIZE = Size(1, 64, 96)  # divisible by the strides of all usual networks
ODD_SIZE = Size(1, 77, 123)  # neither side is divisible by any stride of a network
SMALL_SIZE = Size(1, 37, 53)  # odd as well, for checks in which the size does not matter
TINY_SIZE = Size(1, 9, 13)  # both sides below the 16 or 32 pixels that networks reduce to one
FRAMES = 3  # one without history, one with, and one whose history has a history
SEED, OTHER_SEED = 3, 8  # of two different clips
POOL_SPP = 8  # samples per pixel in the pool


@cache
def make_clip(
    device: torch.device, seed: int, size: Size, pool_spp: int = POOL_SPP, static: bool = False
) -> InMemoryClip:
    """A closed-form clip in memory. All methods share it, so nothing may write to it.

    Its samples stand in for every kind of pool. It has every buffer of the clip format. The
    buffers behind glass and mirrors equal those of the first surface, because it has no glass.
    """
    clip = procedural_clip(seed, size, FRAMES, pool_spp, static=static, device=device)
    return to_clip([replace(frame, gbuffer=_add_buffers(frame.gbuffer)) for frame in clip])


def with_nan_reference(result: FrameResult) -> Frame:
    """The result's frame with NaN as its reference and in every sample that was not drawn."""
    frame, nan = result.frame, float("nan")
    radiance = stored_radiance(frame).where(result.samples.valid_mask, nan)
    half = torch.full_like(frame.reference.half_a, nan)
    pool = StoredPool(radiance, frame.pool.rounding_seeds)
    return replace(frame, pool=pool, reference=Reference(half, half))


def _add_buffers(gbuffer: GBuffer) -> GBuffer:
    """The G-buffer with every buffer of the format: `normal_NAME` is `normal`, and so on."""
    buffers = {**gbuffer.buffers, "object": gbuffer.buffers["depth"].isfinite().float()}
    for name in BUFFER_CHANNELS:
        first_surface = name.partition("_")[0]
        if first_surface in buffers:  # static clips have no motion
            buffers.setdefault(name, buffers[first_surface])
    return replace(gbuffer, buffers=buffers)

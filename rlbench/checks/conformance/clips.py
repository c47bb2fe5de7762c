"""The clips that claims are tried on: closed-form worlds, kept in memory and shared by methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool
from rlbench.run import FrameResult

ODD = Size(1, 77, 123)  # divides by nothing that a network halves by
SMALL = Size(1, 37, 53)  # as odd, where size is not what is asked about
TINY = Size(1, 9, 13)  # both sides below the 16 or 32 pixels that networks halve to one
FRAMES = 3  # one without history, one with, and one whose history had history
SEED, OTHER = 3, 8  # of two worlds
POOL = 8  # samples of each pixel
AWAY = -2.0  # images, along both axes, that motion leads at a cut


@cache
def world(
    device: torch.device, seed: int, size: Size, pool: int = POOL, static: bool = False
) -> InMemoryClip:
    """A closed-form clip in memory. Nothing may be written to it, for all methods see it.

    Its samples stand for those of any kind of pool. Beside the four view buffers it has those of
    what lies behind glass and mirrors, which are the same, for there is no glass here.
    """
    made = procedural(seed, size, FRAMES, pool, static=static, device=device)
    return clip_of([replace(frame, gbuffer=_whole(frame.gbuffer)) for frame in made])


def clip_of(frames: Sequence[Frame]) -> InMemoryClip:
    """Frames as a clip."""
    return InMemoryClip("world", "procedural", "", tuple(frames))


def cut(frame: Frame) -> Frame:
    """The frame as the first of another shot: all motion leads outside."""
    _, _, h, w = frame.gbuffer.buffers["motion"].shape
    away = frame.gbuffer.buffers["motion"].new_tensor([AWAY * w, AWAY * h])
    motion = away.view(1, 2, 1, 1).expand_as(frame.gbuffer.buffers["motion"])
    return replace(frame, gbuffer=GBuffer({**frame.gbuffer.buffers, "motion": motion}))


def with_nan_reference(shown: FrameResult) -> Frame:
    """The frame with NaN for its reference and for every sample that was not bought of it."""
    frame, nan = shown.frame, float("nan")
    pool = _stored(frame)
    radiance = pool.radiance.where(shown.samples.valid_mask, nan)
    halves = torch.full_like(frame.reference.half_a, nan)
    reference = Reference(halves, halves)
    return replace(frame, pool=StoredPool(radiance, pool.rounding_seeds), reference=reference)


def only(frame: Frame, i: int) -> Frame:
    """One clip of a batch."""
    part, pool = slice(i, i + 1), _stored(frame)
    buffers = {key: buffer[part] for key, buffer in frame.gbuffer.buffers.items()}
    return Frame(
        frame.index,
        replace(frame.gbuffer, buffers=buffers),
        StoredPool(pool.radiance[part], pool.rounding_seeds[part]),
        Reference(frame.reference.half_a[part], frame.reference.half_b[part]),
    )


def _stored(frame: Frame) -> StoredPool:
    assert isinstance(frame.pool, StoredPool)
    return frame.pool


def _whole(gbuffer: GBuffer) -> GBuffer:
    """The view with every buffer that format v1 knows."""
    seen: dict[str, Tensor] = dict(gbuffer.buffers)
    seen["object"] = seen["depth"].isfinite().float()
    seen["albedo_first"] = seen["albedo"]
    seen |= {f"{name}_psr": seen[name] for name in ("normal", "depth", "object")}
    return replace(gbuffer, buffers=seen)

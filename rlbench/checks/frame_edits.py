"""Edits of frames: other radiance, other buffers, a new shot; clips of a batch, apart or joined.

Every edit returns new frames; the tensors of the original are not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain

import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Frame, GBuffer, Reference, StoredPool

OUTSIDE = -2.0  # image sizes, along both axes, that motion points away where a shot begins

STAND_INS = {  # values of a buffer that hold no information, but are legal
    "albedo": (0.5, 0.5, 0.5),
    "normal": (0.0, -1.0, 0.0),
    "depth": (5.0,),  # scene units
    "motion": (0.0, 0.0),
}

Edit = Callable[[Tensor], Tensor]


def to_clip(frames: Iterable[Frame]) -> InMemoryClip:
    """A clip of these frames."""
    return InMemoryClip("edited", "procedural", "", tuple(frames))


def stored_radiance(frame: Frame) -> Tensor:
    """The samples of the frame's pool [n s 3 h w]."""
    assert isinstance(frame.pool, StoredPool)
    return frame.pool.radiance


def edit_radiance(frame: Frame, edit: Edit) -> Frame:
    """The frame with `edit` applied to its samples and to both halves of its reference."""
    pool = StoredPool(edit(stored_radiance(frame)), frame.pool.rounding_seeds)
    halves = (edit(frame.reference.half_a), edit(frame.reference.half_b))
    return replace(frame, pool=pool, reference=Reference(*halves))


def edit_tensors(frame: Frame, edit: Edit) -> Frame:
    """The frame with `edit` applied to samples, reference and every buffer."""
    buffers = {name: edit(buffer) for name, buffer in frame.gbuffer.buffers.items()}
    return edit_radiance(replace(frame, gbuffer=replace(frame.gbuffer, buffers=buffers)), edit)


def with_buffers(frame: Frame, **buffers: Tensor) -> Frame:
    """The frame with some buffers replaced."""
    gbuffer = GBuffer({**frame.gbuffer.buffers, **buffers}, frame.gbuffer.static)
    return replace(frame, gbuffer=gbuffer)


def start_new_shot(frame: Frame) -> Frame:
    """The frame as the first of a new shot: all motion points outside the image."""
    motion = frame.gbuffer.buffers["motion"]
    h, w = motion.shape[-2:]
    outside = motion.new_tensor([OUTSIDE * w, OUTSIDE * h]).view(1, 2, 1, 1)
    return with_buffers(frame, motion=outside.expand_as(motion))


def select_clip(frame: Frame, index: int) -> Frame:
    """The frame of one clip of a batch."""
    seeds = frame.pool.rounding_seeds[index : index + 1]
    single = edit_tensors(frame, lambda tensor: tensor[index : index + 1])
    return replace(single, pool=StoredPool(stored_radiance(single), seeds))


def join_clips(clips: Sequence[Sequence[Frame]]) -> InMemoryClip:
    """Clips of one size and length as one batch, in their order."""
    return to_clip(_join_frames(frames) for frames in zip(*clips, strict=True))


def _join_frames(frames: Sequence[Frame]) -> Frame:
    seeds = tuple(chain.from_iterable(frame.pool.rounding_seeds for frame in frames))
    names = frames[0].gbuffer.buffers
    buffers = {name: torch.cat([f.gbuffer.buffers[name] for f in frames]) for name in names}
    return Frame(
        frames[0].index,
        replace(frames[0].gbuffer, buffers=buffers),
        StoredPool(torch.cat([stored_radiance(frame) for frame in frames]), seeds),
        Reference(
            torch.cat([frame.reference.half_a for frame in frames]),
            torch.cat([frame.reference.half_b for frame in frames]),
        ),
    )

"""Measure what a wrong buffer costs a method on clips, one buffer and one edit at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rlbench.checks.frame_edits import to_clip
from rlbench.checks.stress.display import psnr_of_frames
from rlbench.checks.stress.lying_buffers import LIES, Lie, tell_lie
from rlbench.errors import OptionError
from rlbench.frames import BUFFERS, Clip, Frame
from rlbench.method import Method
from rlbench.run import run_clip

__all__ = ["EDITS", "Loss", "measure_losses"]

WARM_UP = 2  # frames that are not scored: before them a temporal method has little history
SHIFTS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # pixels right and down, one after the other


@dataclass(frozen=True)
class Loss:
    """What one edit of one buffer costs a method on one clip."""

    method: str
    clip: str
    buffer: str
    edit: str
    spp: float
    psnr_db: float  # with the right buffer; mean over the scored frames
    lost_db: float  # by the edit; below 0 if it improves the image


def _jitter(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """The buffer shifted by one pixel, in another direction in each frame; edges repeat."""
    buffer = right[index]
    x, y = SHIFTS[index % len(SHIFTS)]
    h, w = buffer.shape[-2:]
    rows = (torch.arange(h, device=buffer.device) - y).clamp(0, h - 1)
    columns = (torch.arange(w, device=buffer.device) - x).clamp(0, w - 1)
    return buffer[..., rows[:, None], columns]


EDITS: dict[str, Lie] = {
    "dropped": LIES["constant"],  # what `rlbench import` writes for a buffer that a source lacks
    "lagged": LIES["lagged"],
    "jittered": _jitter,
    "noised": LIES["noised"],
}


def measure_losses(name: str, method: Method, clip: Clip, spp: float) -> Iterator[Loss]:
    """dB lost by each edit of each buffer that the method declares and the clip has.

    The score is the PSNR of clipped sRGB values, mean over the frames after the first two. Raises
    OptionError for a clip of less than three frames.
    """
    frames = list(clip)
    if len(frames) <= WARM_UP:
        raise OptionError(
            f"clip '{clip.name}' has {len(frames)} frames read; a fingerprint needs {WARM_UP + 1}"
        )
    right = _score(method, frames, spp)
    for buffer in declared_buffers(method, frames[0]):
        for edit, lie in EDITS.items():
            score = _score(method, tell_lie(frames, buffer, lie), spp)
            yield Loss(name, clip.name, buffer, edit, spp, right, right - score)


def declared_buffers(method: Method, frame: Frame) -> list[str]:
    """The buffers that a method reads of a frame; a static clip has no motion."""
    return [n for n in BUFFERS if n in method.traits.inputs and n in frame.gbuffer.buffers]


def _score(method: Method, frames: Sequence[Frame], spp: float) -> float:
    results = list(run_clip(method, to_clip(frames), spp))
    return float(psnr_of_frames(results[WARM_UP:]).mean())

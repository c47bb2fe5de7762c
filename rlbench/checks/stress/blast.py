"""Blast radius: how far, how much and how long one bad value changes the images of a method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.color import encode_srgb

__all__ = ["Blast", "FrameBlast", "compare_frames"]

THRESHOLD = 1e-3  # change of a display value in [0, 1] that counts: a quarter of an 8-bit step
RADIUS = 8  # pixels around the fault that it may change
MAX_CHANGED = 256  # pixels that a contained fault changes in any frame
MIN_PSNR_OUTSIDE = 60.0  # dB, of a contained fault outside that radius
MAX_FRAMES = 6  # until a contained fault has left no trace
MAX_DB = 150.0  # PSNR of equal images


@dataclass(frozen=True)
class FrameBlast:
    """What a fault changed in one frame."""

    changed: int  # pixels
    distance: float  # pixels, from the fault to the farthest changed pixel
    psnr_outside: float  # dB, of the pixels farther than 8 pixels away
    nonfinite: int  # pixels
    largest: float  # finite value in the image, in display whites


@dataclass(frozen=True)
class Blast:
    """What a fault changed in its frame and in the frames after it."""

    frames: Sequence[FrameBlast]

    @property
    def changed(self) -> int:
        """Pixels changed in the frame that has most of them."""
        return max(frame.changed for frame in self.frames)

    @property
    def nonfinite(self) -> int:
        """Pixels that are not finite, in the frame that has most of them."""
        return max(frame.nonfinite for frame in self.frames)

    @property
    def frames_until_clean(self) -> float:
        """Frames with changed pixels, from the fault on; inf if the last frame still has some."""
        dirty = [index for index, frame in enumerate(self.frames) if frame.changed]
        if not dirty:
            return 0
        return dirty[-1] + 1 if dirty[-1] + 1 < len(self.frames) else math.inf

    @property
    def is_contained(self) -> bool:
        """Few pixels changed, next to none outside the radius, and none after six frames."""
        return (
            not self.nonfinite
            and self.changed <= MAX_CHANGED
            and min(frame.psnr_outside for frame in self.frames) >= MIN_PSNR_OUTSIDE
            and self.frames_until_clean <= MAX_FRAMES
        )

    def __str__(self) -> str:
        """The figures in a sentence."""
        farthest = max(frame.distance for frame in self.frames)
        outside = min(frame.psnr_outside for frame in self.frames)
        largest = max(frame.largest for frame in self.frames)
        nonfinite = f"{self.nonfinite} not finite, " if self.nonfinite else ""
        clean = self.frames_until_clean
        trace = f"{clean} frames until clean" if clean < math.inf else "never clean again"
        return (
            f"{self.changed} pixels changed, {nonfinite}up to {farthest:.0f} pixels away; "
            f"{outside:.1f} dB outside {RADIUS} pixels; largest value {largest:.3g}; {trace}"
        )


def compare_frames(
    image: Float[Tensor, "1 3 h w"], clean: Float[Tensor, "1 3 h w"], y: int, x: int
) -> FrameBlast:
    """Compare a frame with the same frame of a run without the fault, which lies at (y, x)."""
    finite = image.isfinite().all(1)[0]
    error = (_display(image) - _display(clean)).abs()[0].masked_fill(~finite, 1.0)
    changed = error.amax(0) > THRESHOLD
    rows, columns = torch.meshgrid(*map(torch.arange, changed.shape), indexing="ij")
    distance = torch.hypot((rows - y).float(), (columns - x).float()).to(changed.device)
    outside = distance > RADIUS
    mse = float(error[:, outside].square().mean())
    return FrameBlast(
        int(changed.sum()),
        float(distance[changed].amax()) if changed.any() else 0.0,
        min(MAX_DB, -10 * math.log10(mse)) if mse > 0 else MAX_DB,
        int((~finite).sum()),
        float(image.where(image.isfinite(), 0.0).amax()),
    )


def _display(image: Tensor) -> Tensor:
    return encode_srgb(image.nan_to_num(0.0).clamp(0, 1))

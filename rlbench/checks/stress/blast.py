"""Blast radius: how far, how much and how long one bad value changes the images of a method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.stress.display import psnr, to_display

__all__ = ["Blast", "FrameBlast", "compare_frames"]

THRESHOLD = 1e-3  # change of a display value in [0, 1] that counts: a quarter of an 8-bit step
RADIUS = 8  # pixels around the fault that it may change
MAX_CHANGED = 256  # pixels that a contained fault changes in any frame
MIN_PSNR_OUTSIDE = 60.0  # dB, of a contained fault outside that radius
MAX_FRAMES = 6  # until a contained fault has left no trace
MAX_DB = 150.0  # PSNR of equal images
TOLERANCE = 1.5  # times as many pixels, or as large a residue, as a legal change: about as much
PSNR_TOLERANCE = 3.0  # dB below a legal change that count as about as much


@dataclass(frozen=True)
class FrameBlast:
    """What a fault changed in one frame."""

    changed_pixels: int
    distance: float  # pixels, from the fault to the farthest changed pixel
    psnr_outside: float  # dB, of the pixels farther than 8 pixels away
    nonfinite: int  # pixels
    error: float  # largest change of a display value in [0, 1]
    loss: float  # dB of PSNR against the reference
    largest: float  # finite value in the image, in display whites


@dataclass(frozen=True)
class Blast:
    """What a fault changed in its frame and in the frames after it."""

    frames: Sequence[FrameBlast]

    @property
    def changed_pixels(self) -> int:
        """Pixels changed in the frame that has most of them."""
        return max(frame.changed_pixels for frame in self.frames)

    @property
    def nonfinite(self) -> int:
        """Pixels that are not finite, in the frame that has most of them."""
        return max(frame.nonfinite for frame in self.frames)

    @property
    def frames_until_clean(self) -> float:
        """Frames with changed pixels, from the fault on; inf if the last frame still has some."""
        dirty = [index for index, frame in enumerate(self.frames) if frame.changed_pixels]
        if not dirty:
            return 0
        return dirty[-1] + 1 if dirty[-1] + 1 < len(self.frames) else math.inf

    @property
    def psnr_outside(self) -> float:
        """The lowest PSNR outside the radius, in dB."""
        return min(frame.psnr_outside for frame in self.frames)

    @property
    def loss(self) -> float:
        """The largest loss of PSNR in any frame, in dB; inf if a pixel is not finite."""
        return math.inf if self.nonfinite else max(frame.loss for frame in self.frames)

    @property
    def residue(self) -> float:
        """The largest change of a display value that is left in the last frame."""
        return self.frames[-1].error

    def is_contained(self, legal: Blast | None = None) -> bool:
        """Few pixels changed, next to none outside the radius, and no residue after six frames.

        `legal` is the blast of a legal change at the same place, such as another sample of the
        same pixel. A fault is contained, too, if it does about as little: a method that
        averages over time cannot forget any sample within six frames.
        """
        most, residue, least_psnr = MAX_CHANGED, THRESHOLD, MIN_PSNR_OUTSIDE
        if legal:
            most = max(most, round(TOLERANCE * legal.changed_pixels))
            residue = max(residue, TOLERANCE * legal.residue)
            least_psnr = min(least_psnr, legal.psnr_outside - PSNR_TOLERANCE)
        return (
            not self.nonfinite
            and self.changed_pixels <= most
            and self.psnr_outside >= least_psnr
            and self.residue <= residue
        )

    def __str__(self) -> str:
        """The figures in a sentence."""
        farthest = max(frame.distance for frame in self.frames)
        largest = max(frame.largest for frame in self.frames)
        nonfinite = f"{self.nonfinite} not finite, " if self.nonfinite else ""
        clean = self.frames_until_clean
        trace = f"{clean} frames until clean" if clean < math.inf else "never clean again"
        return (
            f"{self.changed_pixels} pixels changed, {nonfinite}up to {farthest:.0f} pixels away; "
            f"{self.psnr_outside:.1f} dB outside {RADIUS} pixels; "
            f"largest value {largest:.3g}; {trace}"
        )


def compare_frames(
    image: Float[Tensor, "1 3 h w"],
    clean: Float[Tensor, "1 3 h w"],
    reference: Float[Tensor, "1 3 h w"],
    y: int,
    x: int,
) -> FrameBlast:
    """Compare a frame with the same frame of a run without the fault, which lies at (y, x)."""
    finite = image.isfinite().all(1)[0]
    error = (to_display(image) - to_display(clean)).abs()[0].masked_fill(~finite, 1.0)
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
        float(error.amax()),
        float(psnr(clean, reference) - psnr(image, reference)),
        float(image.where(image.isfinite(), 0.0).amax()),
    )

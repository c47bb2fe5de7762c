"""Runs of a method over one clip in several precisions, with the same samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rlbench.checks.stress.conversion import convert_clip, convert_method, default_dtype
from rlbench.checks.stress.display import psnr
from rlbench.checks.stress.held_density import RecordDensity, ReplayDensity
from rlbench.checks.stress.section import StressedMethod
from rlbench.clips.in_memory import InMemoryClip
from rlbench.method import Method
from rlbench.run import run_clip

__all__ = ["HeldRuns"]


@dataclass(frozen=True)
class HeldRuns:
    """Runs of one method over one clip; all but the first replay its densities."""

    stressed_method: StressedMethod
    clip: InMemoryClip

    @cached_property
    def recording(self) -> tuple[list[Tensor], list[Tensor]]:
        """The images in float32, and the densities."""
        method = RecordDensity(self.stressed_method.method)
        return self.images(method, self.clip), method.densities

    def images(self, method: Method, clip: InMemoryClip) -> list[Tensor]:
        """The images of a clip."""
        return [result.image for result in run_clip(method, clip, self.stressed_method.default_spp)]

    def replay(self, method: Method, clip: InMemoryClip | None = None) -> list[Tensor]:
        """The images of the clip, or of the same clip converted, with the recorded densities."""
        held = ReplayDensity.of(method, self.recording[1])
        return self.images(held, self.clip if clip is None else clip)

    @cached_property
    def truth(self) -> list[Tensor] | Exception:
        """The images in float64, or the exception that a method raises there."""
        try:
            method = convert_method(self.stressed_method.method, torch.float64)
            held = ReplayDensity.of(
                method, self.recording[1]
            )  # recorded in the usual default dtype
            with default_dtype(torch.float64):
                images = self.images(held, convert_clip(self.clip, torch.float64))
        except Exception as error:  # a method may raise anything in a precision it was not made for
            return error
        if images[-1].dtype != torch.float64:
            return TypeError(f"the image is {images[-1].dtype}, so a part computes in it")
        return images

    def loss(self, truth: list[Tensor], images: list[Tensor]) -> float:
        """dB by which the mean PSNR of `images` is below that of `truth`."""
        references = [frame.reference.mean for frame in self.clip]
        pairs = zip(truth, images, references, strict=True)
        losses = [psnr(best.to(ref), ref) - psnr(image.to(ref), ref) for best, image, ref in pairs]
        return float(torch.stack(losses).mean())

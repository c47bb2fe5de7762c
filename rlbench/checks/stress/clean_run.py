"""A run without a fault, which can be repeated with one from the fault's frame on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rlbench.checks.frame_edits import to_clip
from rlbench.checks.stress.blast import MAX_FRAMES, Blast, compare_frames
from rlbench.checks.stress.faults import (
    BACKGROUND,
    VALUES,
    RecordRun,
    ResumeRun,
    brightest_sample,
    plant_in_buffer,
    plant_in_samples,
    plant_in_state,
)
from rlbench.checks.stress.held_density import ReplayDensity
from rlbench.checks.stress.section import StressedMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size
from rlbench.method import Method, State
from rlbench.run import ReadFrame, run_clip
from rlbench.sanitize import sanitize_frame

__all__ = ["CleanRun", "Fault", "run_clean"]

FAULT_FRAME = 2  # two frames of history lie before it
FRAMES = FAULT_FRAME + MAX_FRAMES + 1  # the last one shows whether the sixth left a trace
CLEAN_FRAMES = 2  # in a row, after which a fault is over
SEED = 24


@dataclass(frozen=True)
class Fault:
    """A changed first frame of a repeated run, or a changed state before it."""

    target: str  # "sample", "state" or the name of a buffer
    value: str  # its name, or "legal"
    frame: Frame
    state: State


@dataclass(frozen=True)
class CleanRun:
    """A run without a fault, and what is needed to repeat it from the fault's frame on."""

    stressed: StressedMethod
    frames: Sequence[Frame]  # from the fault's frame on
    images: Sequence[Tensor]
    state: State  # before the fault's frame
    densities: Sequence[Tensor]  # of all passes from the fault's frame on
    pixels: Sequence[tuple[int, int]]  # where the fault's surface is, frame by frame

    @property
    def targets(self) -> list[str]:
        """Where a fault can be planted: sample, buffers, and state if it holds images."""
        buffers = self.frames[0].gbuffer.select(self.stressed.traits.inputs).buffers
        has_state = plant_in_state(self.state, 0.0, self.frames[0].pool.size, 0, 1)[1] > 0
        return ["sample", *sorted(buffers), *(["state"] if has_state else [])]

    def plant(self, target: str, value: str) -> Fault:
        """The fault with the value of this name in VALUES."""
        return self._change(target, value, VALUES[value])

    def repeat_legal(self, target: str, holds_counts: bool) -> Blast:
        """What a legal change at the same place does; of several the one with most pixels."""
        blasts = [self.repeat(change, holds_counts) for change in self._legal_changes(target)]
        return max(blasts, key=lambda blast: blast.changed_pixels)

    def _legal_changes(self, target: str) -> list[Fault]:
        frame, pixel = self.frames[0], self.pixels[0]
        if target == "sample":  # one that found a light, and one that found none
            values: list[float | Tensor | None] = [brightest_sample(frame, *pixel), 0.0]
        elif target == "state":
            values = [None]
        else:
            values = [BACKGROUND[target.partition("_")[0]]]
        return [self._change(target, "legal", value) for value in values]

    def _change(self, target: str, name: str, value: float | Tensor | None) -> Fault:
        frame, (y, x) = self.frames[0], self.pixels[0]
        if target == "state":
            assert not isinstance(value, Tensor)
            state, _ = plant_in_state(self.state, value, frame.pool.size, y, x)
            return Fault(target, name, frame, state)
        assert value is not None
        if target == "sample":
            return Fault(target, name, plant_in_samples(frame, value, y, x), self.state)
        return Fault(target, name, plant_in_buffer(frame, target, value, y, x), self.state)

    def repeat(
        self, fault: Fault, holds_counts: bool = False, read: ReadFrame = sanitize_frame
    ) -> Blast:
        """Run again with a fault, for seven frames or until two in a row are clean."""
        method: Method = self.stressed.method
        if holds_counts:
            method = ReplayDensity.of(method, self.densities)
        clip = to_clip([fault.frame, *self.frames[1:]])
        results = run_clip(ResumeRun(method, fault.state), clip, self.stressed.default_spp, read)
        blasts = []
        for result, clean, pixel in zip(results, self.images, self.pixels, strict=True):
            reference = result.frame.reference.mean
            blasts.append(compare_frames(result.image, clean, reference, *pixel))
            if (
                not any(blast.changed_pixels for blast in blasts[-CLEAN_FRAMES:])
                and len(blasts) > 1
            ):
                break
        return Blast(blasts)


def run_clean(stressed: StressedMethod, size: Size) -> CleanRun:
    """Run the clip without a fault."""
    clip = procedural_clip(SEED, size, FRAMES, device=stressed.device)
    recorded = RecordRun(stressed.method)
    images = [result.image for result in run_clip(recorded, clip, stressed.default_spp)]
    frames = list(clip)[FAULT_FRAME:]
    densities = recorded.densities[FAULT_FRAME * len(stressed.traits.passes) :]
    pixels = _follow(frames, size.h // 2, size.w // 2)
    state = recorded.states[FAULT_FRAME]
    return CleanRun(stressed, frames, images[FAULT_FRAME:], state, densities, pixels)


def _follow(frames: Sequence[Frame], y: int, x: int) -> list[tuple[int, int]]:
    """The pixel in each frame whose motion leads closest to the pixel of the frame before."""
    pixels = [(y, x)]
    for frame in frames[1:]:
        motion = frame.gbuffer.buffers["motion"][0]
        h, w = motion.shape[-2:]
        rows = torch.arange(h, device=motion.device)[:, None] + motion[1] - pixels[-1][0]
        columns = torch.arange(w, device=motion.device) + motion[0] - pixels[-1][1]
        nearest = int((rows.square() + columns.square()).argmin())
        pixels.append(divmod(nearest, w))
    return pixels

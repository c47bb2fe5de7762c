"""One bad pixel: does a single bad value stay where it is, and is it gone after a few frames?

Frame 2 of a moving procedural clip gets one bad value in a sample, in a buffer or in the state. The
images are compared with those of a run without it for seven frames. A legal change at the same
place is the control: the brightest stored sample of the pixel, the buffer of background, or another
pixel's state. Methods that place their samples run with the sample counts of the clean run, and
with free counts, in which the fault may also move samples: images are then equally good rather than
equal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rlbench.checks.result import Verdict
from rlbench.checks.stress.blast import (
    MAX_CHANGED,
    MAX_FRAMES,
    TOLERANCE,
    Blast,
    compare_frames,
)
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
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size
from rlbench.method import Method, State
from rlbench.run import ReadFrame, run_clip
from rlbench.sanitize import read_unsanitized, sanitize_frame

__all__ = ["NAME", "SECTION", "CleanRun", "run_clean"]

NAME = "bad-pixel"
SIZE, QUICK_SIZE = Size(1, 80, 80), Size(1, 48, 48)
CLEAN_FRAMES = 2  # in a row, after which a fault is over
FAULT_FRAME = 2  # two frames of history lie before it
FRAMES = FAULT_FRAME + MAX_FRAMES + 1  # the last one shows whether the sixth left a trace
SEED = 24
QUICK_VALUES = ("nan", "65504")
FREE_VALUES = ("nan", "65504", "minus-one")  # also with free counts, and without sanitising
LEGAL = "legal"
EQUALLY_GOOD = 0.1  # dB: other samples of the same budget move the PSNR of a frame by as much
NOTICEABLE = 1.0  # dB
VISIBLE = 1 / 255  # a residue below one step of an 8-bit display is degraded, not failed
REMEDIES = {
    "sample": "limit outliers before they are accumulated, exposed or filtered "
    "(rlbench.ops.limit_fireflies)",
    "state": "treat history that is not finite or out of range as missing when it is reprojected",
    "buffer": "read depth, normals and albedo through bounded functions (rlbench.ops.sanitize)",
    "counts": "plan each pixel's density from its neighbourhood, not from statistics of the image",
    "raw": "sanitise in the method (rlbench.ops.sanitize), for use outside the suite",
}


@dataclass(frozen=True)
class Fault:
    """A changed first frame of a repeated run, or a changed state before it."""

    target: str  # "sample", "state" or the name of a buffer
    value: str  # its name, or LEGAL
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
        """The fault with the value of this name in VALUES, or a legal change."""
        frame, (y, x) = self.frames[0], self.pixels[0]
        number = VALUES.get(value)
        if target == "state":
            state, _ = plant_in_state(self.state, number, frame.pool.size, y, x)
            return Fault(target, value, frame, state)
        if target == "sample":
            sample = brightest_sample(frame, y, x) if number is None else number
            return Fault(target, value, plant_in_samples(frame, sample, y, x), self.state)
        number = BACKGROUND[target.partition("_")[0]] if number is None else number
        bad = plant_in_buffer(frame, target, number, y, x)
        return Fault(target, value, bad, self.state)

    def repeat(
        self, fault: Fault, holds_counts: bool = False, read: ReadFrame = sanitize_frame
    ) -> Blast:
        """Run again with a fault, for seven frames or until two in a row are clean."""
        method: Method = self.stressed.method
        if holds_counts:
            method = ReplayDensity.of(method, self.densities)
        clip = InMemoryClip("stress", "procedural", "", (fault.frame, *self.frames[1:]))
        results = run_clip(ResumeRun(method, fault.state), clip, self.stressed.default_spp, read)
        blasts = []
        for result, clean, pixel in zip(results, self.images, self.pixels, strict=True):
            reference = result.frame.reference.mean
            blasts.append(compare_frames(result.image, clean, reference, *pixel))
            if not any(blast.changed for blast in blasts[-CLEAN_FRAMES:]) and len(blasts) > 1:
                break
        return Blast(blasts)


def run(stressed: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """One result per planted fault, and one for all of them without the core's sanitising."""
    clean = run_clean(stressed, QUICK_SIZE if quick else SIZE)
    is_adaptive = stressed.traits.adaptive
    for target in clean.targets:
        yield from _compare_values(clean, target, QUICK_VALUES if quick else VALUES, is_adaptive)
        if is_adaptive:
            values = QUICK_VALUES if quick else FREE_VALUES
            yield from _compare_values(clean, target, values, holds_counts=False)
    if not quick:
        yield _judge_unsanitized(clean)


def run_clean(stressed: StressedMethod, size: Size = SIZE) -> CleanRun:
    """Run the clip without a fault."""
    clip = procedural_clip(SEED, size, FRAMES, device=stressed.device)
    recorded = RecordRun(stressed.method)
    images = [result.image for result in run_clip(recorded, clip, stressed.default_spp)]
    frames = list(clip)[FAULT_FRAME:]
    densities = [d for frame in recorded.densities[FAULT_FRAME:] for d in frame]
    pixels = _follow(frames, size.h // 2, size.w // 2)
    state = recorded.states[FAULT_FRAME]
    return CleanRun(stressed, frames, images[FAULT_FRAME:], state, densities, pixels)


def _compare_values(
    clean: CleanRun, target: str, values: Iterable[str], holds_counts: bool
) -> Iterator[StressResult]:
    legal = clean.repeat(clean.plant(target, LEGAL), holds_counts)
    for value in values:
        yield _judge(clean, clean.plant(target, value), legal, holds_counts)


def _judge(clean: CleanRun, fault: Fault, legal: Blast, holds_counts: bool) -> StressResult:
    stressed = clean.stressed
    moves_samples = stressed.traits.adaptive and not holds_counts
    test = f"{fault.target}-{fault.value}" + ("-free" if moves_samples else "")
    kind = fault.target if fault.target in REMEDIES else "buffer"
    remedy = REMEDIES["counts" if moves_samples else kind]
    try:
        blast = clean.repeat(fault, holds_counts)
    except Exception as error:  # e.g. a density that is not finite
        found = f"raised {type(error).__name__}: {error}"
        return StressResult(
            stressed.name, NAME, test, Verdict.FAILED, unit="pixels", found=found, remedy=remedy
        )
    verdict = _verdict_of_loss(blast, legal) if moves_samples else _verdict(blast, legal)
    found = f"{blast}; {blast.loss:.2f} dB lost" if moves_samples else str(blast)
    if not blast.is_contained():
        found += f"; a legal change: {legal}"
    remedy = "" if verdict is Verdict.PASSED else remedy
    figure, limit = float(blast.changed), float(MAX_CHANGED)
    return StressResult(
        stressed.name, NAME, test, verdict, figure, "pixels", limit, found=found, remedy=remedy
    )


def _verdict(blast: Blast, legal: Blast) -> Verdict:
    """Failed if pixels are lost, or if the fault outlives six frames more than a legal change."""
    if blast.is_contained(legal):
        return Verdict.PASSED
    is_lasting = blast.residue > VISIBLE and blast.residue > TOLERANCE * legal.residue
    return Verdict.FAILED if blast.nonfinite or is_lasting else Verdict.WARNING


def _verdict_of_loss(blast: Blast, legal: Blast) -> Verdict:
    """Samples moved: what counts is whether any image lost quality."""
    if blast.is_contained(legal) or blast.loss <= max(EQUALLY_GOOD, TOLERANCE * legal.loss):
        return Verdict.PASSED
    return Verdict.WARNING if blast.loss <= NOTICEABLE else Verdict.FAILED


def _judge_unsanitized(clean: CleanRun) -> StressResult:
    """How many faults of samples and buffers the method contains without the core's help."""
    names = [(t, v) for t in clean.targets for v in FREE_VALUES if t != "state"]
    contained = sum(_is_contained_unsanitized(clean, *name) for name in names)
    share = 100 * contained / len(names)
    verdict = Verdict.PASSED if contained == len(names) else Verdict.WARNING
    found = f"{contained} of {len(names)} faults are contained if the suite repairs nothing"
    remedy = "" if verdict is Verdict.PASSED else REMEDIES["raw"]
    return StressResult(
        clean.stressed.name,
        NAME,
        "unsanitized",
        verdict,
        share,
        "%",
        100.0,
        found=found,
        remedy=remedy,
    )


def _is_contained_unsanitized(clean: CleanRun, target: str, value: str) -> bool:
    holds_counts = clean.stressed.traits.adaptive
    legal = clean.repeat(clean.plant(target, LEGAL), holds_counts)
    try:
        blast = clean.repeat(clean.plant(target, value), holds_counts, read_unsanitized)
    except Exception:  # e.g. a density that is not finite
        return False
    return blast.is_contained(legal)


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


SECTION = MethodSection(NAME, "Does one bad value stay where it is, and does it vanish?", run)

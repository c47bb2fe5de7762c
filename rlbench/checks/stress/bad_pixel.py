"""One bad pixel: does a single bad value stay where it is, and is it gone after a few frames?

Frame 2 of a moving procedural clip gets one bad value in a sample, in a buffer or in the state. The
images are compared with those of a run without it, until they are equal or six frames have passed.
Methods that place their samples run twice: with the sample counts of the clean run, and with free
counts, in which the fault may also move samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rlbench.checks.result import Verdict
from rlbench.checks.stress.blast import MAX_CHANGED, MAX_FRAMES, Blast, compare_frames
from rlbench.checks.stress.faults import (
    VALUES,
    HoldDensities,
    RecordRun,
    ResumeRun,
    plant_in_buffer,
    plant_in_samples,
    plant_in_state,
)
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size
from rlbench.method import Method, State
from rlbench.run import ReadFrame, run_clip
from rlbench.sanitize import read_unsanitized, sanitize_frame

__all__ = ["NAME", "SECTION", "find_blast"]

NAME = "bad-pixel"
SIZE, QUICK_SIZE = Size(1, 128, 128), Size(1, 64, 64)
FAULT_FRAME = 2  # two frames of history lie before it
FRAMES = FAULT_FRAME + MAX_FRAMES + 1  # the last one shows whether the sixth left a trace
SEED = 24
QUICK_VALUES = ("nan", "65504")
REMEDIES = {
    "samples": "limit outliers before they are accumulated, exposed or filtered "
    "(rlbench.ops.limit_fireflies), and take exposure from a robust mean",
    "state": "treat history that is not finite or out of range as missing when it is reprojected",
    "buffers": "read depth, normals and albedo through bounded functions (rlbench.ops.sanitize)",
    "counts": "plan each pixel's density from its neighbourhood, not from statistics of the image",
}


@dataclass(frozen=True)
class CleanRun:
    """A run without a fault, and what is needed to repeat it from the fault's frame on."""

    stressed: StressedMethod
    frames: Sequence[Frame]  # from the fault's frame on
    images: Sequence[Tensor]
    state: State  # before the fault's frame
    densities: Sequence[Tensor]  # of all passes from the fault's frame on
    pixels: Sequence[tuple[int, int]]  # where the fault's surface is, frame by frame

    def repeat(
        self,
        frame: Frame,
        state: State,
        is_held: bool,
        read: ReadFrame = sanitize_frame,
    ) -> Blast:
        """Run again with another first frame or state, until no pixel differs."""
        method: Method = self.stressed.method
        if is_held:
            method = HoldDensities(method, list(self.densities))
        clip = _to_clip([frame, *self.frames[1:]])
        results = run_clip(ResumeRun(method, state), clip, self.stressed.default_spp, read)
        blasts = []
        for result, clean, pixel in zip(results, self.images, self.pixels, strict=True):
            blasts.append(compare_frames(result.image, clean, *pixel))
            if torch.equal(result.image, clean):
                break
        return Blast(blasts)


def run(stressed: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """One result per planted fault, and one for all of them without the core's sanitising."""
    clean = _run_clean(stressed, QUICK_SIZE if quick else SIZE)
    values = {name: VALUES[name] for name in QUICK_VALUES} if quick else VALUES
    faults = list(_plant(stressed, clean, values))
    yield from (
        _judge(stressed, clean, fault, is_held) for fault in faults for is_held in fault.modes
    )
    if not quick:
        yield _judge_unsanitized(stressed, clean, faults)


@dataclass(frozen=True)
class Fault:
    """A bad value, planted in the first frame of a repeated run or in the state before it."""

    target: str  # "sample", "state" or the name of a buffer
    value: str  # its name
    frame: Frame
    state: State
    modes: tuple[bool, ...]  # with held counts, with free counts, or both

    @property
    def name(self) -> str:
        """Name of the test with held or necessarily constant counts."""
        return f"{self.target}-{self.value}"


def _plant(stressed: StressedMethod, clean: CleanRun, values: dict[str, float]) -> Iterator[Fault]:
    frame, (y, x) = clean.frames[0], clean.pixels[0]
    modes = (True, False) if stressed.traits.adaptive else (False,)
    buffers = [name for name in sorted(stressed.traits.inputs) if name in frame.gbuffer.buffers]
    for name, value in values.items():
        bad = plant_in_samples(frame, value, y, x)
        yield Fault("sample", name, bad, clean.state, modes)
        for buffer in buffers:
            bad = plant_in_buffer(frame, buffer, value, y, x)
            yield Fault(buffer, name, bad, clean.state, modes)
        state, count = plant_in_state(clean.state, value, frame.pool.size, y, x)
        if count:
            yield Fault("state", name, frame, state, modes)


def _judge(stressed: StressedMethod, clean: CleanRun, fault: Fault, is_held: bool) -> StressResult:
    moves_samples = stressed.traits.adaptive and not is_held
    test = fault.name + ("-free" if moves_samples else "")
    kind = {"sample": "samples", "state": "state"}.get(fault.target, "buffers")
    remedy = REMEDIES["counts" if moves_samples else kind]
    try:
        blast = clean.repeat(fault.frame, fault.state, is_held)
    except Exception as error:  # e.g. a density that is not finite
        found = f"raised {type(error).__name__}: {error}"
        return StressResult(
            stressed.name, NAME, test, Verdict.FAILED, unit="pixels", found=found, remedy=remedy
        )
    verdict = Verdict.PASSED if blast.is_contained else Verdict.WARNING
    if blast.nonfinite or blast.frames_until_clean > MAX_FRAMES:
        verdict = Verdict.FAILED
    return StressResult(
        stressed.name,
        NAME,
        test,
        verdict,
        float(blast.changed),
        "pixels",
        good=float(MAX_CHANGED),
        found=str(blast),
        remedy="" if blast.is_contained else remedy,
    )


def _judge_unsanitized(
    stressed: StressedMethod, clean: CleanRun, faults: Sequence[Fault]
) -> StressResult:
    """How many faults of samples and buffers the method contains without the core's help."""
    given = [fault for fault in faults if fault.target != "state"]
    contained = [fault for fault in given if _is_contained_unsanitized(clean, fault)]
    share = len(contained) / len(given)
    return StressResult(
        stressed.name,
        NAME,
        "without-sanitizing",
        Verdict.PASSED if share == 1 else Verdict.WARNING,
        100 * share,
        "%",
        good=100.0,
        found=f"{len(contained)} of {len(given)} faults of samples and buffers are contained "
        "where the suite does not replace invalid values",
        remedy="" if share == 1 else "apply rlbench.ops.sanitize in the method, for use elsewhere",
    )


def _is_contained_unsanitized(clean: CleanRun, fault: Fault) -> bool:
    """An exception, such as that of a density which is not finite, counts as not contained."""
    try:
        is_held = fault.modes[0]
        return clean.repeat(fault.frame, fault.state, is_held, read_unsanitized).is_contained
    except Exception:
        return False


def find_blast(stressed: StressedMethod, target: str, value: float, is_held: bool = False) -> Blast:
    """What one bad value does to a method; `target` is sample, state or a buffer's name."""
    clean = _run_clean(stressed, SIZE)
    (fault,) = (f for f in _plant(stressed, clean, {"": value}) if f.target == target)
    return clean.repeat(fault.frame, fault.state, is_held)


def _run_clean(stressed: StressedMethod, size: Size) -> CleanRun:
    clip = procedural_clip(SEED, size, FRAMES, device=stressed.device)
    recorded = RecordRun(stressed.method)
    images = [r.image for r in run_clip(recorded, clip, stressed.default_spp)]
    frames = list(clip)[FAULT_FRAME:]
    densities = [d for frame in recorded.densities[FAULT_FRAME:] for d in frame]
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


def _to_clip(frames: Sequence[Frame]) -> InMemoryClip:
    return InMemoryClip("stress", "procedural", "", tuple(frames))


SECTION = MethodSection(NAME, "Does one bad value stay where it is, and does it vanish?", run)

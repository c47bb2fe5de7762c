"""Section `bad-pixel`: a bad value stays in its pixel, and is gone after a few frames.

Frame 2 of a moving procedural clip gets one bad value in a sample, in a buffer or in the state. The
images are compared with those of a run without it for seven frames. A legal change at the same
place is the control: the brightest stored sample of the pixel or a black one, the buffer of
background, or another pixel's state. Methods that place their samples run with the sample counts of
the clean run, and with free counts, in which the fault may also move samples: images are then
equally good rather than equal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.display import psnr, to_display
from rlbench.checks.frame_edits import stored_radiance, to_clip, with_buffers
from rlbench.checks.result import CheckResult, Limits, Verdict, judge
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.checks.stress.wrappers import RecordDensity, ReplayDensity, ResumeRun
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size, StoredPool
from rlbench.method import Method, State
from rlbench.ops.nested_tensors import iterate_tensors
from rlbench.run import ReadFrame, run_clip
from rlbench.sanitize import read_unsanitized, sanitize_frame

SIZE, QUICK_SIZE = Size(1, 64, 64), Size(1, 48, 48)
QUICK_VALUES = ("nan", "65504")
FREE_VALUES = ("nan", "65504", "minus-one")  # also with free counts, and without sanitising
EQUALLY_GOOD = 0.1  # dB: other samples of the same budget move the PSNR of a frame by as much
NOTICEABLE = 1.0  # dB
SHARE = Limits(good=100.0, fair=0.0, unit="%")  # without the core's help: never a failure
VISIBLE = 1 / 255  # a residue below one step of an 8-bit display is degraded, not failed
REMEDIES = {
    "sample": "limit outliers before they are accumulated, exposed or filtered "
    "(rlbench.ops.limit_fireflies)",
    "state": "treat history that is not finite or out of range as missing when it is reprojected",
    "buffer": "read depth, normals and albedo through bounded functions (rlbench.ops.sanitize)",
    "counts": "plan each pixel's density from its neighbourhood, not from statistics of the image",
    "raw": "sanitise in the method (rlbench.ops.sanitize), for use outside the suite",
}

VALUES = {
    "nan": math.nan,
    "inf": math.inf,
    "1e30": 1e30,
    "65504": 65504.0,
    "1e5": 1e5,
    "minus-one": -1.0,
    "denormal": 1e-40,
}
BACKGROUND = {"albedo": 0.0, "normal": 0.0, "depth": math.inf, "motion": 1e4}  # legal values

SEED = 24
FAULT_FRAME = 2  # two frames of history lie before it
MAX_FRAMES = 6  # until a contained fault has left no trace
FRAMES = FAULT_FRAME + MAX_FRAMES + 1  # the last one shows whether the sixth left a trace
CLEAN_FRAMES = 2  # in a row, after which a fault is over

THRESHOLD = 1e-3  # change of a display value in [0, 1] that counts: a quarter of an 8-bit step
RADIUS = 8  # pixels around the fault that it may change
MAX_CHANGED = 256  # pixels that a contained fault changes in any frame
CHANGED = Limits(good=float(MAX_CHANGED), unit="pixels")
MIN_PSNR_OUTSIDE = 60.0  # dB, of a contained fault outside that radius
MAX_DB = 150.0  # PSNR of equal images
TOLERANCE = 1.5  # times as many pixels, or as large a residue, as a legal change: about as much
PSNR_TOLERANCE = 3.0  # dB below a legal change that count as about as much


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """One result per planted fault, and one for all of them without the core's sanitising."""
    clean = run_clean(stressed, QUICK_SIZE if is_quick else SIZE)
    is_adaptive = stressed.traits.adaptive
    legal = {target: clean.repeat_legal(target, is_adaptive) for target in clean.targets}
    for target in clean.targets:
        for value in QUICK_VALUES if is_quick else VALUES:
            yield _judge(clean, clean.plant(target, value), legal[target], is_adaptive)
        if is_adaptive:
            moving = clean.repeat_legal(target, holds_counts=False)
            for value in QUICK_VALUES if is_quick else FREE_VALUES:
                yield _judge(clean, clean.plant(target, value), moving, holds_counts=False)
    if not is_quick:
        yield _judge_unsanitized(clean, legal)


def _judge(clean: CleanRun, fault: Fault, legal: Blast, holds_counts: bool) -> CheckResult:
    moves_samples = clean.stressed.traits.adaptive and not holds_counts
    test = f"{fault.target}-{fault.value}" + ("-free" if moves_samples else "")
    kind = fault.target if fault.target in REMEDIES else "buffer"
    remedy = REMEDIES["counts" if moves_samples else kind]
    try:
        blast = clean.repeat(fault, holds_counts)
    except Exception as error:  # e.g. a density that is not finite
        found = f"raised {type(error).__name__}: {error}"
        return CheckResult(test, Verdict.FAILED, found, remedy, limits=Limits(unit=CHANGED.unit))
    verdict = _verdict_of_loss(blast, legal) if moves_samples else _verdict(blast, legal)
    found = f"{blast}; {blast.loss:.2f} dB lost" if moves_samples else str(blast)
    if not blast.is_contained():
        found += f"; a legal change: {legal}"
    remedy = "" if verdict is Verdict.PASSED else remedy
    return CheckResult(test, verdict, found, remedy, blast.changed_pixels, CHANGED)


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


def _judge_unsanitized(clean: CleanRun, legal: Mapping[str, Blast]) -> CheckResult:
    """How many faults of samples and buffers the method contains without the core's help."""
    faults = [clean.plant(t, v) for t in clean.targets for v in FREE_VALUES if t != "state"]
    contained = sum(_is_contained_unsanitized(clean, f, legal[f.target]) for f in faults)
    found = f"{contained} of {len(faults)} faults are contained if the suite repairs nothing"
    return judge("unsanitized", 100 * contained / len(faults), SHARE, found, REMEDIES["raw"])


def _is_contained_unsanitized(clean: CleanRun, fault: Fault, legal: Blast) -> bool:
    try:
        blast = clean.repeat(fault, clean.stressed.traits.adaptive, read_unsanitized)
    except Exception:  # e.g. a density that is not finite
        return False
    return blast.is_contained(legal)


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
        values: list[float | Tensor | None]
        if target == "sample":  # one that found a light, and one that found none
            y, x = self.pixels[0]
            samples = stored_radiance(self.frames[0])[0, :, :, y, x]
            values = [samples[samples.sum(1).argmax()][None], 0.0]
        else:
            values = [None if target == "state" else BACKGROUND[target.partition("_")[0]]]
        changes = [self._change(target, "legal", value) for value in values]
        blasts = [self.repeat(change, holds_counts) for change in changes]
        return max(blasts, key=lambda blast: blast.changed_pixels)

    def repeat(
        self, fault: Fault, holds_counts: bool = False, read: ReadFrame = sanitize_frame
    ) -> Blast:
        """Run again with a fault, for seven frames or until two in a row are clean."""
        method: Method = self.stressed.method
        if holds_counts:
            method = ReplayDensity.of(method, self.densities)
        clip = to_clip([fault.frame, *self.frames[1:]])
        results = run_clip(ResumeRun(method, fault.state), clip, self.stressed.default_spp, read)
        blasts: list[FrameBlast] = []
        for result, clean, pixel in zip(results, self.images, self.pixels, strict=True):
            reference = result.frame.reference.mean
            blasts.append(compare_frames(result.image, clean, reference, *pixel))
            last = blasts[-CLEAN_FRAMES:]
            if len(last) == CLEAN_FRAMES and not any(blast.changed_pixels for blast in last):
                break
        return Blast(blasts)

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


def run_clean(stressed: StressedMethod, size: Size) -> CleanRun:
    """Run the clip without a fault."""
    clip = procedural_clip(SEED, size, FRAMES, device=stressed.device)
    recorded = RecordDensity(stressed.method)
    results = stressed.run(clip, method=recorded)
    frames = list(clip)[FAULT_FRAME:]
    images = [result.image for result in results[FAULT_FRAME:]]
    densities = recorded.densities[FAULT_FRAME * len(stressed.traits.passes) :]
    pixels = _follow(frames, size.h // 2, size.w // 2)
    return CleanRun(stressed, frames, images, results[FAULT_FRAME - 1].state, densities, pixels)


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


def plant_in_samples(frame: Frame, value: float | Tensor, y: int, x: int) -> Frame:
    """The frame with `value`, a number or a colour [n 3], as one pixel's first sample."""
    radiance = stored_radiance(frame).clone()
    radiance[:, 0, :, y, x] = value
    return replace(frame, pool=StoredPool(radiance, frame.pool.rounding_seeds))


def plant_in_buffer(frame: Frame, name: str, value: float | Tensor, y: int, x: int) -> Frame:
    """The frame with `value`, a number or one per channel [n c], in one pixel of a buffer."""
    buffer = frame.gbuffer.buffers[name].clone()
    buffer[..., y, x] = value
    return with_buffers(frame, **{name: buffer})


def plant_in_state(
    state: State, value: float | None, size: Size, y: int, x: int
) -> tuple[State, int]:
    """A copy of the state with `value` at one pixel, and the number of tensors that hold it.

    The pixel is (y, x) in tensors [n c h w] of the frame's size. In another layout it is half a
    line behind the middle of the last dimension: the centre of images that are stored line by line.
    Tensors with fewer elements than the frame has pixels hold no image: they stay unchanged. With
    None the pixel gets the values of the one halfway to the left border.
    """
    copied, count = deepcopy(state), 0
    for tensor in iterate_tensors(copied):
        if tensor.is_floating_point() and tensor.numel() >= size.n * size.h * size.w:
            is_image = tensor.shape[-2:] == (size.h, size.w)
            middle = tensor.shape[-1] // 2 + size.w // 2
            pixel = tensor[..., y, x] if is_image else tensor[..., middle]
            other = tensor[..., y, x // 2] if is_image else tensor[..., middle - size.w // 4]
            pixel.copy_(other.clone() if value is None else pixel.new_tensor(value))
            count += 1
    return copied, count


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


SECTION = MethodSection(run)

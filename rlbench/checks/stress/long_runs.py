"""Section long-runs: drift, growth and convergence of temporal methods over 1,000 frames.

Variants of a family run 400 frames, to save time. A method that declares no memory must give the
image of each frame alone, however many it has seen; one that returns a state all the same runs too.
"""

from __future__ import annotations

import gc
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench.checks.display import largest_difference, psnr
from rlbench.checks.frame_edits import join_clips, to_clip
from rlbench.checks.result import CheckResult, Limits, judge, not_applicable
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.in_memory import ComputedFrames, InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Samples, Size, StoredPool
from rlbench.method import State
from rlbench.ops.nested_tensors import iterate_parts, iterate_tensors
from rlbench.run import FrameResult, run_clip
from rlbench.wrappers import HalfPrecision

FRAMES, VARIANT_FRAMES, HALF_FRAMES, QUICK_FRAMES = 1000, 400, 220, 48
WINDOW, QUICK_WINDOW = 100, 16  # frames over which a PSNR is averaged
STATIC, MOVING = 0, 1  # positions in the batch
CLIP_NAMES = {STATIC: "static", MOVING: "moving"}
STATE_STEP = 10  # frames between two looks at the values of the state

SEED = 7100
SIDE = 16  # pixels: a frame of a network costs little more than its overhead
POOL_SPP = 8
SIGMA = 0.8  # standard deviation of the logarithm of a sample of the static clip

# The window's mean has a standard error of about 0.1 dB; 0.5 dB is the least that a viewer sees.
DRIFT = Limits(good=0.5, fair=2.0, unit="dB")
# A counter may gain a digit. What grows by a value per frame exhausts any memory in the end.
STATE_GROWTH = Limits(good=0.1, fair=16.0, unit="B/frame")
# A cache may fill once. 16 x 16 pixels in float32 are 1,024 bytes: less than a map in 10 frames.
MEMORY_GROWTH = Limits(good=16.0, fair=256.0, unit="B/frame")
# The clip's samples reach about 300. Up to 65504 the state can be stored in half floats.
MAGNITUDE = Limits(good=65504.0, fair=1e6, unit="")
# The mean of all samples gains 3 dB; a third of that still ends near the truth.
CONVERGENCE = Limits(good=1.0, fair=0.1, unit="dB/doubling")
# No worse than the mean of all samples; 6 dB is twice its error.
CONVERGENCE_GAP = Limits(good=0.0, fair=6.0, unit="dB")

# What the moving camera sees costs sound methods up to 3 dB; a black image costs more than 8.
DIP = Limits(good=4.0, fair=8.0, unit="dB")
# Bit-equal: a frame's image, alone and after others.
SAME_IMAGE = Limits(good=0.0, fair=0.0, unit="display")
ALL_FINITE = Limits(good=0.0, fair=0.0, unit="frames")
DIP_FRAMES = 10  # in a row: a third of a second

ALONE = "frame-alone"
TESTS = (
    *(f"{test}-{clip}" for clip in CLIP_NAMES.values() for test in ("drift", "dip")),
    *("convergence", "convergence-gap", "state-growth", "memory-growth", "state-magnitude"),
    *("finite", "finite-bf16"),
    *(f"{test}-{clip}-bf16" for clip in CLIP_NAMES.values() for test in ("drift", "dip")),
)
DECLARE = "declare Traits(temporal=True), or keep nothing of earlier frames and return None"
FINITE = "find the frame and the division, logarithm or overflow in it; bound what is accumulated"
LIMIT_HISTORY = "bound every accumulated value, and forget old frames at a fixed rate"
CONVERGE = (
    "on static pixels, weight the history by its number of samples, and blend the filtered image "
    "towards the accumulated one as that number grows"
)


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """All tests of one method; of one without a state, that it has no memory at all."""
    if stressed.traits.temporal:
        yield not_applicable(ALONE, "keeps a state: Traits(temporal=True)")
    else:
        yield _judge_alone(stressed, QUICK_FRAMES if is_quick else HALF_FRAMES)
    if not stressed.keeps_state:
        for test in TESTS:
            yield not_applicable(test, "keeps no state: Traits(temporal=False)")
        return
    window = QUICK_WINDOW if is_quick else WINDOW
    frames = VARIANT_FRAMES if "/" in stressed.name else FRAMES
    full = _record_run(stressed, QUICK_FRAMES if is_quick else frames, window)
    yield from _judge_quality(full, STATIC)
    yield from _judge_convergence(full)
    yield from _judge_growth(full)
    yield _judge_finite(full)
    if not is_quick:  # its windows are shorter than a period of the moving camera, 52 frames
        yield from _judge_quality(full, MOVING)
        half = replace(
            stressed, method=HalfPrecision(stressed.method, stressed.device, torch.bfloat16)
        )
        half_run = _record_run(half, HALF_FRAMES, window)
        for clip in CLIP_NAMES:
            yield from _judge_quality(half_run, clip, "-bf16")
        yield _judge_finite(half_run, "-bf16")


def _judge_alone(stressed: StressedMethod, frames: int) -> CheckResult:
    """The largest difference between a frame's image alone and after others, first and last."""
    clip = long_clip(frames, stressed.device)
    results = run_clip(stressed.method, clip, stressed.default_spp)
    first, *_, last = ((result.image, result.frame) for result in results)
    alone = [stressed.run(to_clip([frame]))[0].image for _, frame in (first, last)]
    figure = largest_difference([first[0], last[0]], alone)
    found = f"of the images of frames 0 and {frames - 1} to those of each frame alone"
    if stressed.keeps_state:
        found += "; a state is returned"
    return judge(ALONE, figure, SAME_IMAGE, found, DECLARE)


@dataclass(frozen=True)
class _LongRun:
    """Figures of a long run; window `early` begins at a fifth of its length, `last` ends the run.

    Bytes are those at the first frame of `early` and after the last frame.
    """

    described: str  # what was run
    early: slice  # frames
    last: slice  # frames
    psnr: Float[Tensor, "frames n"]
    sample_psnr: Float[Tensor, "frames n"]  # of the mean of each frame's samples
    mean_psnr: Float[Tensor, " frames"]  # of the mean of all samples so far, static clip
    state_bytes: tuple[int, int]
    live_bytes: tuple[int, int]
    largest_value: float  # absolute, of the state
    nonfinite: list[int]  # frames in which a pixel of either image is not finite


@dataclass
class _RunningMean:
    """The mean of all samples of the static clip."""

    total: Tensor | float = 0.0
    count: Tensor | float = 0.0

    def add(self, samples: Samples) -> Tensor:
        """The mean [1 3 h w] with the samples of one more frame; each has equal weight."""
        self.total = self.total + samples.radiance[STATIC : STATIC + 1].sum(1)
        self.count = self.count + samples.counts[STATIC : STATIC + 1]
        assert isinstance(self.count, Tensor)
        return self.total / self.count.clamp_min(1)


def _record_run(stressed: StressedMethod, frames: int, window: int) -> _LongRun:
    """Run a method over a long clip, static and moving in one batch, and keep no image.

    `window` is the number of frames of the windows `early` and `last`.
    """
    clip = long_clip(frames, stressed.device)
    early = slice(min(20, frames // 4), min(20, frames // 4) + window)
    running_mean = _RunningMean()
    scores, bytes_at, largest, nonfinite = [], {}, 0.0, []
    for result in run_clip(stressed.method, clip, stressed.default_spp):
        index = result.frame.index
        scores.append(_score(result, running_mean))
        nonfinite += [] if bool(result.image.isfinite().all()) else [index]
        if index in (early.start, frames - 1):
            bytes_at[index] = count_state_bytes(result.state), count_live_bytes()
        if index % STATE_STEP == 0 or index == frames - 1:
            largest = max(find_largest_value(result.state), largest, key=_nan_last)
    (state_before, live_before), (state_after, live_after) = bytes_at.values()
    image, sample, mean = (torch.tensor(column) for column in zip(*scores, strict=True))
    return _LongRun(
        f"{frames} frames of {clip.size.w}x{clip.size.h} at {stressed.default_spp:g} spp",
        early,
        slice(frames - window, frames),
        image,
        sample,
        mean[:, 0],
        (state_before, state_after),
        (live_before, live_after),
        largest,
        nonfinite,
    )


def _score(result: FrameResult, running_mean: _RunningMean) -> tuple[list[float], ...]:
    """PSNR of the image, of the frame's samples, and of the mean of all samples so far."""
    reference = result.frame.reference.mean
    static = reference[STATIC : STATIC + 1]
    pairs = (
        (result.image, reference),
        (result.samples.mean, reference),
        (running_mean.add(result.samples), static),
    )
    return tuple(psnr(image, truth).tolist() for image, truth in pairs)


def _nan_last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _judge_quality(run: _LongRun, clip: int, suffix: str = "") -> Iterator[CheckResult]:
    """dB lost from the early to the last frames, and at most in ten frames of the whole run.

    They are relative to the mean of each frame's samples, because the content of a moving clip
    changes, and medians are compared, because a firefly costs the samples several dB.
    """
    gain = run.psnr[:, clip] - run.sample_psnr[:, clip]
    early, late = gain[run.early].median(), gain[run.last].median()
    found = (
        f"gain over the samples {early:.2f} dB in {_frames(run.early)}, {late:.2f} dB in "
        f"{_frames(run.last)}; {run.described}"
    )
    name = f"{CLIP_NAMES[clip]}{suffix}"
    yield judge(f"drift-{name}", float(early - late), DRIFT, found, LIMIT_HISTORY)
    medians = gain.unfold(0, DIP_FRAMES, 1).median(-1).values
    falls = medians.cummax(0).values - medians
    at = int(falls.argmax())
    found = (
        f"gain over the samples {medians[at]:.2f} dB in {_frames(slice(at, at + DIP_FRAMES))}, "
        f"{medians[: at + 1].max():.2f} dB before; {run.described}"
    )
    yield judge(f"dip-{name}", float(falls.max()), DIP, found, LIMIT_HISTORY)


def _judge_convergence(run: _LongRun) -> Iterator[CheckResult]:
    """On the static clip: dB gained per doubling of frames, and dB below the running mean."""
    doublings = torch.arange(1.0, len(run.psnr) + 1).log2()
    late = doublings >= math.log2(run.early.start)  # at first, history fills
    gained, mean_gained = (
        _slope(doublings[late], psnr[late]) for psnr in (run.psnr[:, STATIC], run.mean_psnr)
    )
    image, mean = run.psnr[run.last, STATIC].mean(), run.mean_psnr[run.last].mean()
    slopes = f"the mean of all samples gains {mean_gained:.2f} dB; {run.described}"
    yield judge("convergence", gained, CONVERGENCE, slopes, CONVERGE)
    levels = f"{image:.1f} dB in {_frames(run.last)}, the mean of all samples {mean:.1f} dB"
    yield judge("convergence-gap", float(mean - image), CONVERGENCE_GAP, levels, CONVERGE)


def _judge_finite(run: _LongRun, suffix: str = "") -> CheckResult:
    """Frames of the whole run, of either clip, whose image is not finite."""
    first = f", the first is frame {run.nonfinite[0]}" if run.nonfinite else ""
    found = f"{len(run.nonfinite)} frames are not finite{first}; {run.described}"
    return judge(f"finite{suffix}", len(run.nonfinite), ALL_FINITE, found, FINITE)


def _judge_growth(run: _LongRun) -> Iterator[CheckResult]:
    """Bytes per frame that state and process gain after the early frames; largest state value."""
    frames = len(run.psnr) - run.early.start
    growth = (run.state_bytes[1] - run.state_bytes[0]) / frames
    bound = "keep a fixed number of tensors of fixed size in the state"
    found = f"{run.state_bytes[0]:,} bytes at frame {run.early.start}, {run.state_bytes[1]:,} last"
    yield judge("state-growth", growth, STATE_GROWTH, found, bound)
    growth = (run.live_bytes[1] - run.live_bytes[0]) / frames
    found = f"{run.live_bytes[1] - run.live_bytes[0]:,} more bytes of tensors after {frames} frames"
    remove = "keep nothing outside the state: no list, cache or attribute that grows with frames"
    yield judge("memory-growth", growth, MEMORY_GROWTH, found, remove)
    found = f"largest finite value {run.largest_value:g}; {run.described}"
    yield judge("state-magnitude", run.largest_value, MAGNITUDE, found, LIMIT_HISTORY)


def _slope(x: Tensor, y: Tensor) -> float:
    """Slope of the least-squares line, each doubling with equal weight.

    Frames are weighted by 1 / x', the density of doublings, so that late ones do not outvote.
    """
    weight = 2.0**-x
    weight = weight / weight.sum()
    dx = x - (weight * x).sum()
    return float((weight * dx * y).sum() / (weight * dx * dx).sum())


def _frames(window: slice) -> str:
    return f"frames {window.start} to {window.stop - 1}"


def long_clip(frames: int, device: torch.device) -> InMemoryClip:
    """A batch of two clips, each frame computed when it is read, and freed after it.

    In clip 0 neither camera nor objects move, and motion is zero everywhere; in clip 1 both move.
    All frames of both have new noise. Differs from a clip of one static shot, whose motion is None,
    so that both can run as one batch.
    """
    computed = ComputedFrames(frames, _LongFrames(frames, device).join)
    return InMemoryClip("long", "procedural", "", computed)


@dataclass(frozen=True)
class _LongFrames:
    """Computes the frames of both clips of the batch."""

    length: int
    device: torch.device

    def join(self, index: int) -> Frame:
        """One frame of the static and of the moving clip, as a batch."""
        moving = self._moving.frames[index]
        return join_clips([[self._static_frame(index, moving)], [moving]]).frames[0]

    @cached_property
    def _moving(self) -> InMemoryClip:
        size = Size(1, SIDE, SIDE)
        return procedural_clip(SEED + MOVING, size, self.length, POOL_SPP, device=self.device)

    @cached_property
    def _static(self) -> Frame:
        size = Size(1, SIDE, SIDE)
        return procedural_clip(SEED, size, 1, 1, static=True, device=self.device).frames[0]

    def _static_frame(self, index: int, moving: Frame) -> Frame:
        """The static camera's frame: radiance times noise without the moving clip's fireflies.

        With them, the mean of 2,000 samples would still be far from the truth.
        """
        generator = torch.Generator().manual_seed(SEED + index)  # equal on every device
        z = torch.randn(1, POOL_SPP, 1, SIDE, SIDE, generator=generator).to(self.device)
        radiance = self._static.reference.mean[:, None] * torch.exp(SIGMA * z - SIGMA**2 / 2)
        seeds = tuple(seed + 1 for seed in moving.pool.rounding_seeds)
        motion = torch.zeros_like(moving.gbuffer.buffers["motion"])
        gbuffer = GBuffer({**self._static.gbuffer.buffers, "motion": motion})
        return Frame(index, gbuffer, StoredPool(radiance, seeds), self._static.reference)


def count_state_bytes(state: State) -> int:
    """Bytes of all tensors in a state, and of the Python objects that hold them.

    >>> count_state_bytes([torch.zeros(4)]) - count_state_bytes([torch.zeros(2)])
    8
    """
    return sum(
        part.numel() * part.element_size() if isinstance(part, Tensor) else sys.getsizeof(part)
        for part in iterate_parts(state)
    )


def find_largest_value(state: State) -> float:
    """The largest absolute value of all finite floats in a state, NaN where a tensor holds NaN.

    Infinity does not count, because it is the depth of the background.

    >>> find_largest_value({"a": torch.tensor([-3.0, torch.inf]), "b": torch.tensor([2.0])})
    3.0
    """
    floats = [part.float() for part in iterate_tensors(state) if part.is_floating_point()]
    if any(bool(tensor.isnan().any()) for tensor in floats):
        return math.nan
    values = (tensor.where(tensor.isfinite(), 0.0).abs() for tensor in floats if tensor.numel())
    return max((float(value.max()) for value in values), default=0.0)


def count_live_bytes() -> int:
    """Bytes of all tensors that any Python object of the process refers to, on any device."""
    gc.collect()
    tensors = [thing for thing in gc.get_objects() if type(thing) in (Tensor, nn.Parameter)]
    storages = (tensor.untyped_storage() for tensor in tensors)
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())


SECTION = MethodSection(run)

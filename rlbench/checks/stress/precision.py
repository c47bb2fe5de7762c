"""Section precision: float64 as truth for lower precisions; reruns, threads, batch, device."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from rlbench.checks.frame_edits import select_clip, to_clip
from rlbench.checks.stress.conversion import convert_clip, convert_method, thread_count
from rlbench.checks.stress.display import largest_difference
from rlbench.checks.stress.held_density import RecordDensity, ReplayDensity
from rlbench.checks.stress.held_runs import HeldRuns
from rlbench.checks.stress.result import Limits, StressResult, judge, skip
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.wrappers import HalfPrecision

__all__ = ["SECTION", "run"]

NAME = "precision"
SEED = 7200
CLIPS = 3  # in the batch; all other tests run the first one alone
SIZE, QUICK_SIZE = Size(CLIPS, 32, 48), Size(CLIPS, 16, 24)
FRAMES, QUICK_FRAMES = 5, 3
THREAD_FRAMES = 2  # one without history, one with: two threads on a busy core are slow

# PSNR is reported with two digits, so float32 must not change them.
FLOAT32_LOSS = Limits(good=0.005, fair=0.1, unit="dB")
# An ablation's differences are a few tenths of a dB.
HALF_LOSS = Limits(good=0.1, fair=0.5, unit="dB")
# 1e-3 is the blast radius' threshold of a changed pixel; 1/255 is a step of an 8-bit display.
FLOAT32_PIXEL = Limits(good=1e-3, fair=1 / 255, unit="display")
# bf16 has 8 bits, so a step of 8-bit sRGB is unavoidable; 8 steps are visible in a smooth region.
HALF_PIXEL = Limits(good=8 / 255, fair=32 / 255, unit="display")
BIT_EQUAL = Limits(good=0.0, fair=0.0, unit="display")

KEEP_FLOAT32 = "compute exposure, sums over many pixels, divisions and logarithms in float32"


def run(stressed_method: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """All tests of one method."""
    size, frames = (QUICK_SIZE, QUICK_FRAMES) if quick else (SIZE, FRAMES)
    clip = procedural_clip(SEED, size, frames, device=stressed_method.device)
    batch = to_clip(clip)
    runs = HeldRuns(stressed_method, to_clip(select_clip(frame, 0) for frame in batch))
    yield from _judge_float32(runs)
    yield from _judge_reduced(runs, "bf16", torch.bfloat16)
    if not quick:  # slow on a CPU, and on busy cores
        yield from _judge_reduced(runs, "fp16", torch.float16)
        yield _judge_threads(runs)
    yield _judge_rerun(runs)
    yield _judge_batch(stressed_method, batch)
    yield _judge_device(runs)


def _judge_float32(runs: HeldRuns) -> Iterator[StressResult]:
    """float32 against float64."""
    if isinstance(runs.truth, Exception):
        reason = f"does not run in float64: {_first_line(runs.truth)}"
        for test in ("float32", "float32-worst-pixel"):
            yield skip(runs.stressed_method.name, NAME, test, reason)
        return
    images, _ = runs.recording
    yield from _judge_pair(runs, "float32", images, (FLOAT32_LOSS, FLOAT32_PIXEL))


def _judge_reduced(runs: HeldRuns, label: str, dtype: torch.dtype) -> Iterator[StressResult]:
    """A reduced precision against float64, or against float32 where there is no float64."""
    device = runs.stressed_method.device
    try:
        images = runs.replay(HalfPrecision(runs.stressed_method.method, device, dtype))
    except Exception as error:  # a method may raise anything in a precision it was not made for
        reason = f"does not run in {label}: {_first_line(error)}"
        for test in (label, f"{label}-worst-pixel"):
            yield skip(runs.stressed_method.name, NAME, test, reason)
        return
    yield from _judge_pair(runs, label, images, (HALF_LOSS, HALF_PIXEL))


def _judge_pair(
    runs: HeldRuns, label: str, images: list[Tensor], limits: tuple[Limits, Limits]
) -> Iterator[StressResult]:
    """dB lost and worst pixel of images of a lower precision."""
    has_truth = not isinstance(runs.truth, Exception)
    truth = runs.recording[0] if isinstance(runs.truth, Exception) else runs.truth
    against = f"against {'float64' if has_truth else 'float32'}, {_describe(runs.clip)}"
    name = runs.stressed_method.name
    yield judge(name, NAME, label, runs.loss(truth, images), limits[0], against, KEEP_FLOAT32)
    worst = largest_difference(truth, images)
    yield judge(name, NAME, f"{label}-worst-pixel", worst, limits[1], against, KEEP_FLOAT32)


def _judge_rerun(runs: HeldRuns) -> StressResult:
    """A second run with free densities must be equal in every bit."""
    again = RecordDensity(runs.stressed_method.method)
    images = runs.images(again, runs.clip)
    pairs = zip((*images, *again.densities), (*runs.recording[0], *runs.recording[1]), strict=True)
    changed = sum(not torch.equal(one, other) for one, other in pairs)
    worst = largest_difference(images, runs.recording[0]) if changed else 0.0
    found = f"{changed} images and densities differ, {_describe(runs.clip)}"
    remedy = "seed every random number from arguments, and keep no state in the method"
    limits = BIT_EQUAL if worst or not changed else Limits(0.0, -1.0)  # densities alone differ
    return judge(runs.stressed_method.name, NAME, "rerun", worst, limits, found, remedy)


def _judge_threads(runs: HeldRuns) -> StressResult:
    """Two threads against one, with the densities held."""
    clip = to_clip(runs.clip.frames[:THREAD_FRAMES])
    images = []
    for threads in (1, 2):
        with thread_count(threads):
            images.append(runs.replay(runs.stressed_method.method, clip))
    remedy = "add in an order that does not depend on threads: no atomics, no data races"
    return _judge_difference(runs.stressed_method, "threads", largest_difference(*images), remedy)


def _judge_batch(stressed_method: StressedMethod, batch: InMemoryClip) -> StressResult:
    """Each clip alone against its part of the batch, with the densities of the batch."""
    together = HeldRuns(stressed_method, batch)
    images, densities = together.recording
    worst = 0.0
    for i in range(CLIPS):
        single = to_clip(select_clip(frame, i) for frame in batch)
        held = [density[i : i + 1] for density in densities]
        alone = together.images(ReplayDensity.of(stressed_method.method, held), single)
        worst = max(worst, largest_difference(alone, [image[i : i + 1] for image in images]))
    remedy = "reduce over the dimensions of one image, never over the batch"
    return _judge_difference(stressed_method, "batch", worst, remedy)


def _judge_device(runs: HeldRuns) -> StressResult:
    """The other kind of device, if there is one."""
    stressed_method = runs.stressed_method
    if not torch.cuda.is_available():
        return skip(stressed_method.name, NAME, "device", "this machine has no CUDA device")
    other = torch.device("cuda" if stressed_method.device.type == "cpu" else "cpu")
    method = convert_method(stressed_method.method, device=other)
    images = runs.replay(method, convert_clip(runs.clip, device=other))
    remedy = "avoid TF32 and operations whose result depends on the device"
    images = [image.to(stressed_method.device) for image in images]
    worst = largest_difference(images, runs.recording[0])
    return _judge_difference(stressed_method, "device", worst, remedy)


def _judge_difference(
    stressed_method: StressedMethod, test: str, worst: float, remedy: str
) -> StressResult:
    """The worst pixel where sums may be added in another order."""
    found = f"largest difference {worst:.2g} on the display, sample counts held"
    return judge(stressed_method.name, NAME, test, worst, FLOAT32_PIXEL, found, remedy)


def _describe(clip: InMemoryClip) -> str:
    return f"{len(clip)} frames of {clip.size.w}x{clip.size.h}"


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


SECTION = MethodSection(
    NAME, "How much do precision, threads, batch and device change the image?", run
)

"""Section long-runs: drift, growth and convergence of temporal methods over 1,000 frames.

Variants of a family run 400 frames, to save time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import torch

from rlbench.checks.stress.long_clip import MOVING, STATIC
from rlbench.checks.stress.recorded_run import LongRun, record_run
from rlbench.checks.stress.result import Limits, StressResult, judge, skip
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.wrappers import HalfPrecision

__all__ = ["SECTION", "run"]

NAME = "long-runs"
FRAMES, VARIANT_FRAMES, HALF_FRAMES, QUICK_FRAMES = 1000, 400, 220, 48
WINDOW, QUICK_WINDOW = 100, 16  # frames over which a PSNR is averaged
CLIP_NAMES = {STATIC: "static", MOVING: "moving"}

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

TESTS = (
    *(f"drift-{clip}" for clip in CLIP_NAMES.values()),
    *("convergence", "convergence-gap", "state-growth", "memory-growth", "state-magnitude"),
    *(f"drift-{clip}-bf16" for clip in CLIP_NAMES.values()),
)
LIMIT_HISTORY = "bound every accumulated value, and forget old frames at a fixed rate"
CONVERGE = (
    "on static pixels, weight the history by its number of samples, and blend the filtered image "
    "towards the accumulated one as that number grows"
)


def run(stressed_method: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """All tests of one method; a method without a state is skipped."""
    name = stressed_method.name
    if not stressed_method.traits.temporal:
        for test in TESTS:
            yield skip(name, NAME, test, "keeps no state: Traits(temporal=False)")
        return
    window = QUICK_WINDOW if quick else WINDOW
    frames = VARIANT_FRAMES if "/" in name else FRAMES
    full = record_run(stressed_method, QUICK_FRAMES if quick else frames, window)
    yield _judge_drift(name, full, STATIC, "")
    yield from _judge_convergence(name, full)
    yield from _judge_growth(name, full)
    if not quick:  # its windows are shorter than a period of the moving camera, 52 frames
        yield _judge_drift(name, full, MOVING, "")
        half = HalfPrecision(stressed_method.method, stressed_method.device)
        half_method = StressedMethod(name, half, stressed_method.device)
        half_run = record_run(half_method, HALF_FRAMES, window)
        yield from (_judge_drift(name, half_run, clip, "-bf16") for clip in CLIP_NAMES)


def _judge_drift(name: str, run: LongRun, clip: int, suffix: str) -> StressResult:
    """dB lost from the early to the last frames, relative to the mean of each frame's samples.

    The samples' own PSNR is subtracted, because the content of a moving clip changes, and medians
    are compared, because a firefly costs the samples several dB.
    """
    gain = run.psnr[:, clip] - run.sample_psnr[:, clip]
    early, late = gain[run.early].median(), gain[run.last].median()
    found = (
        f"gain over the samples {early:.2f} dB in {_frames(run.early)}, {late:.2f} dB in "
        f"{_frames(run.last)}; {run.described}"
    )
    test = f"drift-{CLIP_NAMES[clip]}{suffix}"
    return judge(name, NAME, test, float(early - late), DRIFT, found, LIMIT_HISTORY)


def _judge_convergence(name: str, run: LongRun) -> Iterator[StressResult]:
    """On the static clip: dB gained per doubling of frames, and dB below the running mean."""
    doublings = torch.arange(1.0, len(run.psnr) + 1).log2()
    late = doublings >= math.log2(run.early.start)  # at first, history fills
    gained, mean_gained = (
        _slope(doublings[late], psnr[late]) for psnr in (run.psnr[:, STATIC], run.mean_psnr)
    )
    image, mean = run.psnr[run.last, STATIC].mean(), run.mean_psnr[run.last].mean()
    convergence = partial(judge, name, NAME, remedy=CONVERGE)
    slopes = f"the mean of all samples gains {mean_gained:.2f} dB; {run.described}"
    yield convergence("convergence", gained, CONVERGENCE, slopes)
    levels = f"{image:.1f} dB in {_frames(run.last)}, the mean of all samples {mean:.1f} dB"
    yield convergence("convergence-gap", float(mean - image), CONVERGENCE_GAP, levels)


def _judge_growth(name: str, run: LongRun) -> Iterator[StressResult]:
    """Bytes per frame that state and process gain after the early frames; largest state value."""
    frames = len(run.psnr) - run.early.start
    growth = (run.state_bytes[1] - run.state_bytes[0]) / frames
    bound = "keep a fixed number of tensors of fixed size in the state"
    found = f"{run.state_bytes[0]:,} bytes at frame {run.early.start}, {run.state_bytes[1]:,} last"
    yield judge(name, NAME, "state-growth", growth, STATE_GROWTH, found, bound)
    growth = (run.live_bytes[1] - run.live_bytes[0]) / frames
    found = f"{run.live_bytes[1] - run.live_bytes[0]:,} more bytes of tensors after {frames} frames"
    remove = "keep nothing outside the state: no list, cache or attribute that grows with frames"
    yield judge(name, NAME, "memory-growth", growth, MEMORY_GROWTH, found, remove)
    found = f"largest finite value {run.largest_value:g}; {run.described}"
    yield judge(name, NAME, "state-magnitude", run.largest_value, MAGNITUDE, found, LIMIT_HISTORY)


def _slope(x: torch.Tensor, y: torch.Tensor) -> float:
    """Slope of the least-squares line, each doubling with equal weight.

    Frames are weighted by 1 / x', the density of doublings, so that late ones do not outvote.
    """
    weight = 2.0**-x
    weight = weight / weight.sum()
    dx = x - (weight * x).sum()
    return float((weight * dx * y).sum() / (weight * dx * dx).sum())


def _frames(window: slice) -> str:
    return f"frames {window.start} to {window.stop - 1}"


SECTION = MethodSection(NAME, "Does it stay stable, and converge, over 1,000 frames?", run)

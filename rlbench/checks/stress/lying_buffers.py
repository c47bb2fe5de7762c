"""Section lying-buffers: what a wrong G-buffer costs, and what a right one is worth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

from rlbench.checks.frame_edits import join_clips
from rlbench.checks.stress.display import psnr_of_frames
from rlbench.checks.stress.lies import CONSTANTS, LIES, tell_lie
from rlbench.checks.stress.result import Limits, StressResult, judge, skip
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size

__all__ = ["SECTION", "run"]

NAME = "lying-buffers"
SEED = 7500
SIZE, QUICK_SIZE = Size(2, 32, 48), Size(1, 16, 24)
FRAMES, QUICK_FRAMES = 6, 4
FIRST = 2  # the first frame that is scored: before it, a temporal method has little history

# A small error must have a small effect: 1 dB is hardly visible, 3 dB are twice the error.
SMALL_LIE = Limits(good=1.0, fair=3.0, unit="dB")
# A large error may cost all that the buffer is worth, but no more: worth is 2 to 3 dB for most.
LARGE_LIE = Limits(good=3.0, fair=6.0, unit="dB")
# A buffer that gains nothing should not be declared; one that costs quality is misused. Figures of
# useless buffers lie within 0.1 dB of zero.
WORTH = Limits(good=-0.1, fair=-0.5, unit="dB")

LIMITS = {
    "noised": SMALL_LIE,
    "lagged": SMALL_LIE,
    "dropped": LARGE_LIE,
    "negated": LARGE_LIE,
}
DISTRUST = "weight '{}' by its agreement with the samples, and corrupt it at random in training"
UNUSED = "remove '{}' from Traits(inputs=...), or find why it misleads the method"


def run(stressed_method: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """All tests of one method; a buffer that it does not declare is skipped."""
    declared = [name for name in CONSTANTS if name in stressed_method.traits.inputs]
    for name in CONSTANTS:
        if name not in declared:
            for test in (*LIMITS, "worth"):
                reason = f"does not declare '{name}'"
                yield skip(stressed_method.name, NAME, f"{name}-{test}", reason)
    if declared:
        losses = _measure_losses(stressed_method, declared, quick)
        for name in declared:
            yield from _judge_buffer(stressed_method, name, losses)


def _measure_losses(
    stressed_method: StressedMethod, declared: list[str], quick: bool
) -> dict[tuple[str, str], float]:
    """dB lost by each lie about each buffer; all clips run as one batch with the right one."""
    size, length = (QUICK_SIZE, QUICK_FRAMES) if quick else (SIZE, FRAMES)
    clip = procedural_clip(SEED, size, length, device=stressed_method.device)
    frames = tuple(clip)
    lies = list(product(declared, LIES))
    clips = [frames, *(tell_lie(frames, name, LIES[lie]) for name, lie in lies)]
    right, *wrong = _score_clips(stressed_method, clips)
    return {lie: right - score for lie, score in zip(lies, wrong, strict=True)}


def _score_clips(stressed_method: StressedMethod, clips: Sequence[Sequence[Frame]]) -> list[float]:
    """Mean PSNR of each clip, in one batch; NaN for a clip with which the method raises."""
    try:
        scores = psnr_of_frames(stressed_method.run(join_clips(clips)))[FIRST:].mean(0)
    except Exception:  # a method may raise anything, and one clip must not hide the others
        if len(clips) == 1:
            return [math.nan]
        return [score for clip in clips for score in _score_clips(stressed_method, [clip])]
    return scores.view(len(clips), -1).mean(1).tolist()


def _judge_buffer(
    stressed_method: StressedMethod, name: str, losses: dict[tuple[str, str], float]
) -> Iterator[StressResult]:
    """dB lost by each lie, and dB gained by the right buffer over a constant one."""
    worth = losses[name, "constant"]
    for lie, limits in LIMITS.items():
        found = f"the right buffer gains {worth:.2f} dB over a constant one"
        test, remedy = f"{name}-{lie}", DISTRUST.format(name)
        if math.isnan(losses[name, lie]):
            found = "the method raises an exception, or the density is not finite"
        yield judge(stressed_method.name, NAME, test, losses[name, lie], limits, found, remedy)
    value = ", ".join(f"{each:g}" for each in CONSTANTS[name])
    found, remedy = f"the constant is ({value})", UNUSED.format(name)
    yield judge(stressed_method.name, NAME, f"{name}-worth", worth, WORTH, found, remedy)


SECTION = MethodSection(NAME, "What does a wrong buffer cost, and what is a right one worth?", run)

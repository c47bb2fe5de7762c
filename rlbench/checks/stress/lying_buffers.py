"""Section lying-buffers: what a wrong G-buffer costs, and what a right one is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import torch
from torch import Tensor

from rlbench.checks.display import psnr_of_frames
from rlbench.checks.frame_edits import STAND_INS as CONSTANTS
from rlbench.checks.frame_edits import join_clips, with_buffers
from rlbench.checks.result import CheckResult, Limits, judge, not_applicable
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size

SEED = 7500
SIZE, QUICK_SIZE = Size(2, 32, 48), Size(1, 16, 24)
FRAMES, QUICK_FRAMES = 6, 4
FIRST = 2  # the first frame that is scored: before it, a temporal method has little history
NOISE = 0.1  # standard deviation, in the buffer's unit; of depth, a share of it

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


def _drop(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Zero, as from a renderer that does not export the buffer."""
    return torch.zeros_like(right[index])


def _add_noise(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Gaussian noise; the result is legal: albedo in [0, 1], unit normals, no negative depth."""
    generator = torch.Generator().manual_seed(index)
    noise = NOISE * torch.randn(right[index].shape, generator=generator).to(right[index])
    if name == "albedo":
        return (right[index] + noise).clamp(0, 1)
    if name == "normal":
        is_surface = right[index].square().sum(1, keepdim=True) > 0
        return torch.nn.functional.normalize(right[index] + noise).where(is_surface, 0.0)
    if name == "depth":
        return right[index] * noise.exp()
    return right[index] + noise


def _delay(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """The buffer of the previous frame; the right one in frame 0."""
    return right[max(index - 1, 0)]


def _negate(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """Every finite value with the other sign; background keeps its infinite depth."""
    return torch.where(right[index].isfinite(), -right[index], right[index])


def _flatten(name: str, right: Sequence[Tensor], index: int) -> Tensor:
    """The same legal value everywhere."""
    value = right[index].new_tensor(CONSTANTS[name]).view(-1, 1, 1)
    return value.expand_as(right[index]).contiguous()


Lie = Callable[[str, Sequence[Tensor], int], Tensor]  # name, the buffer in all frames, the frame
LIES: dict[str, Lie] = {
    "dropped": _drop,
    "noised": _add_noise,
    "lagged": _delay,
    "negated": _negate,
    "constant": _flatten,
}


def tell_lie(frames: Sequence[Frame], name: str, lie: Lie) -> list[Frame]:
    """The frames with the buffer `name` replaced by what `lie` makes of it."""
    right = [frame.gbuffer.buffers[name] for frame in frames]
    return [with_buffers(frame, **{name: lie(name, right, i)}) for i, frame in enumerate(frames)]


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """All tests of one method; a buffer that it does not declare is skipped."""
    declared = [name for name in CONSTANTS if name in stressed.traits.inputs]
    for name in CONSTANTS:
        if name not in declared:
            for test in (*LIMITS, "worth"):
                yield not_applicable(f"{name}-{test}", f"does not declare '{name}'")
    if declared:
        losses = _measure_losses(stressed, declared, is_quick)
        for name in declared:
            yield from _judge_buffer(name, losses)


def _measure_losses(
    stressed: StressedMethod, declared: list[str], is_quick: bool
) -> dict[tuple[str, str], float]:
    """dB lost by each lie about each buffer; all clips run as one batch with the right one."""
    size, length = (QUICK_SIZE, QUICK_FRAMES) if is_quick else (SIZE, FRAMES)
    frames = tuple(procedural_clip(SEED, size, length, device=stressed.device))
    lies = list(product(declared, LIES))
    clips = [frames, *(tell_lie(frames, name, LIES[lie]) for name, lie in lies)]
    right, *wrong = _score_clips(stressed, clips)
    return {lie: right - score for lie, score in zip(lies, wrong, strict=True)}


def _score_clips(stressed: StressedMethod, clips: Sequence[Sequence[Frame]]) -> list[float]:
    """Mean PSNR of each clip, in one batch; NaN for a clip with which the method raises."""
    try:
        scores = psnr_of_frames(stressed.run(join_clips(clips)))[FIRST:].mean(0)
    except Exception:  # a method may raise anything, and one clip must not hide the others
        if len(clips) == 1:
            return [math.nan]
        return [score for clip in clips for score in _score_clips(stressed, [clip])]
    return scores.view(len(clips), -1).mean(1).tolist()


def _judge_buffer(name: str, losses: dict[tuple[str, str], float]) -> Iterator[CheckResult]:
    """dB lost by each lie, and dB gained by the right buffer over a constant one."""
    worth = losses[name, "constant"]
    for lie, limits in LIMITS.items():
        found = f"the right buffer gains {worth:.2f} dB over a constant one"
        if math.isnan(losses[name, lie]):
            found = "the method raises an exception, or the density is not finite"
        yield judge(f"{name}-{lie}", losses[name, lie], limits, found, DISTRUST.format(name))
    value = ", ".join(f"{each:g}" for each in CONSTANTS[name])
    found = f"the constant is ({value})"
    yield judge(f"{name}-worth", worth, WORTH, found, UNUSED.format(name))


SECTION = MethodSection(run)

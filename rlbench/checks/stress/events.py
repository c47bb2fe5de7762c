"""Sudden events: a flash of one frame, and a teleport of the camera."""

from __future__ import annotations

from collections.abc import Iterator

from jaxtyping import Float
from torch import Tensor

from rlbench.checks.frame_edits import edit_radiance, join_clips, start_new_shot, to_clip
from rlbench.checks.stress.display import psnr_of_frames
from rlbench.checks.stress.result import Limits, StressResult, judge, skip
from rlbench.checks.stress.section import StressedMethod
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size

__all__ = ["FLASH_FACTOR", "judge_events"]

SEED = 7400
SIZE, QUICK_SIZE = Size(2, 32, 48), Size(1, 16, 24)
BEFORE = 4  # frames before the event
AFTER, QUICK_AFTER = 9, 3  # frames from the event on
FLASH_FACTOR = 100.0
RECOVERED_DB = 1.0  # dB of loss at which a frame counts as recovered

# A marked event leaves nothing of the history: the image equals that of a first frame.
MARKED_LOSS = Limits(good=0.1, fair=1.0, unit="dB")
# Where no buffer says so, a method can still compare samples and surfaces with its history.
# 1 dB is hardly visible for a frame, 3 dB are twice the error.
UNMARKED_LOSS = Limits(good=1.0, fair=3.0, unit="dB")
# At 30 frames per second, 5 frames are the 170 ms in which a change masks errors.
RECOVERY = Limits(good=1.0, fair=5.0, unit="frames")

TESTS = ("flash", "flash-recovery", "teleport-marked", "teleport", "teleport-recovery")
DETECT = "compare new samples with the history, and drop the history where they contradict it"


def judge_events(
    stressed_method: StressedMethod, section: str, quick: bool
) -> Iterator[StressResult]:
    """All tests of events; a method without a state is skipped."""
    if not stressed_method.traits.temporal:
        for test in TESTS:
            reason = "keeps no state: Traits(temporal=False)"
            yield skip(stressed_method.name, section, test, reason)
        return
    size, after = (QUICK_SIZE, QUICK_AFTER) if quick else (SIZE, AFTER)
    yield from _judge_flash(stressed_method, section, size, after)
    yield from _judge_teleports(stressed_method, section, size, after)


def _judge_flash(
    stressed_method: StressedMethod, section: str, size: Size, after: int
) -> Iterator[StressResult]:
    """dB lost after a frame in which all light is 100 times as bright, against no such frame."""
    length = BEFORE + 1 + after
    clip = procedural_clip(SEED, size, length, device=stressed_method.device).frames
    flashed = [_brighten(frame) if i == BEFORE else frame for i, frame in enumerate(clip)]
    scores = psnr_of_frames(stressed_method.run(join_clips([clip, flashed])))
    calm, flash = scores.chunk(2, dim=1)
    losses = (calm - flash).mean(1)[BEFORE + 1 :]
    yield from _judge_losses(stressed_method, section, "flash", losses)


def _judge_teleports(
    stressed_method: StressedMethod, section: str, size: Size, after: int
) -> Iterator[StressResult]:
    """dB lost after a cut, against a clip that begins there: marked by motion, and unmarked."""
    length = BEFORE + after
    clip = procedural_clip(SEED, size, length, cut=BEFORE, device=stressed_method.device).frames
    marked = [start_new_shot(frame) if i == BEFORE else frame for i, frame in enumerate(clip)]
    results = stressed_method.run(join_clips([clip, marked]))
    unmarked_scores, marked_scores = psnr_of_frames(results)[BEFORE:].chunk(2, dim=1)
    fresh = psnr_of_frames(stressed_method.run(to_clip(marked[BEFORE:])))
    losses = (fresh - marked_scores).mean(1)
    worst, found = float(losses.max()), _list_losses(losses)
    remedy = "treat motion that points outside the image as the end of all history"
    yield judge(stressed_method.name, section, "teleport-marked", worst, MARKED_LOSS, found, remedy)
    yield from _judge_losses(
        stressed_method, section, "teleport", (fresh - unmarked_scores).mean(1)
    )


def _judge_losses(
    stressed_method: StressedMethod, section: str, test: str, losses: Float[Tensor, " frames"]
) -> Iterator[StressResult]:
    """The largest loss after an event, and the number of frames until it stays below 1 dB."""
    name, found = stressed_method.name, _list_losses(losses)
    yield judge(name, section, test, float(losses.max()), UNMARKED_LOSS, found, DETECT)
    affected = (~(losses <= RECOVERED_DB)).nonzero()
    frames = float(affected.max() + 1) if len(affected) else 0.0
    lasting = f"within {RECOVERED_DB:g} dB after {frames:g} of {len(losses)} frames"
    yield judge(name, section, f"{test}-recovery", frames, RECOVERY, lasting, DETECT)


def _brighten(frame: Frame) -> Frame:
    return edit_radiance(frame, lambda radiance: FLASH_FACTOR * radiance)


def _list_losses(losses: Float[Tensor, " frames"]) -> str:
    return "dB lost per frame: " + ", ".join(f"{loss:.1f}" for loss in losses.tolist())

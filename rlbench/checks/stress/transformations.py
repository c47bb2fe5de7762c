"""Section transformations: changes of a clip that must not change the error, and sudden events."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from rlbench.checks.frame_edits import edit_tensors, join_clips, select_clip, to_clip
from rlbench.checks.stress.display import psnr, psnr_of_frames
from rlbench.checks.stress.events import judge_events
from rlbench.checks.stress.held_density import RecordDensity, ReplayDensity
from rlbench.checks.stress.plain_clips import PLAIN_CLIPS
from rlbench.checks.stress.result import Limits, StressResult, judge
from rlbench.checks.stress.sample_order import ReversedSamples
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.checks.stress.symmetries import IDENTITY, SYMMETRIES
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size
from rlbench.run import run_clip

__all__ = ["SECTION", "run"]

NAME = "transformations"
SEED = 7300
SIZE, QUICK_SIZE = Size(3, 32, 48), Size(1, 16, 24)  # adaptive counts differ: several clips
FRAMES, QUICK_FRAMES = 4, 3
SHIFTS = (0, 1, 5, 8, 15)  # pixels, along both axes; networks and autoexposure have tiles of 16
MARGIN = 2  # pixels inside the border of each shifted crop that are not compared

# The error is the same by symmetry. 0.5 dB covers rounding of sample counts at other pixels.
SYMMETRY_LOSS = Limits(good=0.5, fair=2.0, unit="dB")
# PSNR between both images. Above 58.9 dB they are equal in 8 bits; at 40 dB the change is visible.
ORDER_PSNR = Limits(good=58.9, fair=40.0, unit="dB")
# There is no noise to remove. At 40 dB an error is just visible, at 30 dB it is obvious.
PLAIN_PSNR = Limits(good=40.0, fair=30.0, unit="dB")


def run(stressed_method: StressedMethod, quick: bool) -> Iterator[StressResult]:
    """All tests of one method."""
    size, frames = (QUICK_SIZE, QUICK_FRAMES) if quick else (SIZE, FRAMES)
    clip = to_clip(procedural_clip(SEED, size, frames, device=stressed_method.device))
    yield from _judge_symmetries(stressed_method, clip)
    yield _judge_shifts(stressed_method, size, frames)
    yield _judge_sample_order(stressed_method, clip)
    yield from _judge_plain(stressed_method, clip)
    yield from judge_events(stressed_method, NAME, quick)


def _judge_symmetries(
    stressed_method: StressedMethod, clip: InMemoryClip
) -> Iterator[StressResult]:
    """The change in dB by an edit that is undone in the image; all edits run in one batch."""
    symmetries = {"original": IDENTITY, **SYMMETRIES}
    edited = [[each.edit(frame) for frame in clip] for each in symmetries.values()]
    results = stressed_method.run(join_clips(edited))
    scores = {}
    for i, (test, symmetry) in enumerate(symmetries.items()):
        part = slice(i * clip.size.n, (i + 1) * clip.size.n)
        scores[test] = _mean(
            psnr(symmetry.undo(result.image[part]), frame.reference.mean)
            for result, frame in zip(results, clip, strict=True)
        )
        if test in SYMMETRIES:
            figure = symmetry.figure(scores["original"] - scores[test])
            found = f"{scores[test]:.2f} dB, the original {scores['original']:.2f} dB"
            remedy = symmetry.remedy
            yield judge(stressed_method.name, NAME, test, figure, SYMMETRY_LOSS, found, remedy)


def _judge_shifts(stressed_method: StressedMethod, size: Size, frames: int) -> StressResult:
    """The spread of PSNR of one region in crops that begin at other pixels."""
    extent, (n, h, w) = max(SHIFTS), size
    h += extent  # so that the region that all crops share is as high as `size`
    large_size = Size(n, h + extent, w + extent)
    large = procedural_clip(SEED, large_size, frames, device=stressed_method.device)
    crops = [[_crop(frame, shift, h, w) for frame in large] for shift in SHIFTS]
    results = stressed_method.run(join_clips(crops))
    scores = []
    for i, shift in enumerate(SHIFTS):
        first, last = extent - shift + MARGIN, -shift - MARGIN  # the region that all crops share
        part, inner = slice(i * n, (i + 1) * n), slice(first, last)
        region = (part, slice(None), inner, inner)
        scores.append(
            _mean(
                psnr(result.image[region], result.frame.reference.mean[region])
                for result in results
            )
        )
    found = ", ".join(
        f"{shift} px {score:.2f} dB" for shift, score in zip(SHIFTS, scores, strict=True)
    )
    spread = max(scores) - min(scores)
    remedy = "pad instead of tiling, and take statistics over overlapping windows"
    return judge(stressed_method.name, NAME, "sub-tile-shift", spread, SYMMETRY_LOSS, found, remedy)


def _judge_sample_order(stressed_method: StressedMethod, clip: InMemoryClip) -> StressResult:
    """PSNR between the images from the same samples in another order, with the densities held."""
    recorded = RecordDensity(stressed_method.method)
    spp = max(stressed_method.default_spp, min(4.0, stressed_method.traits.spp_range[1]))
    images = [result.image for result in run_clip(recorded, clip, spp)]
    held = ReplayDensity.of(ReversedSamples(stressed_method.method), recorded.densities)
    reversed_images = [result.image for result in run_clip(held, clip, spp)]
    worst = min(float(psnr(a, b).min()) for a, b in zip(images, reversed_images, strict=True))
    found = f"PSNR between the images, least of {len(clip)} frames, {spp:g} spp"
    remedy = "treat samples as a set: sum or average over them, without weights by their position"
    return judge(stressed_method.name, NAME, "sample-order", worst, ORDER_PSNR, found, remedy)


def _judge_plain(stressed_method: StressedMethod, clip: InMemoryClip) -> Iterator[StressResult]:
    """The least PSNR of clips without noise."""
    first = [select_clip(frame, 0) for frame in clip]
    batch = join_clips([make(first) for make in PLAIN_CLIPS.values()])
    least = psnr_of_frames(stressed_method.run(batch)).amin(0)
    for test, score in zip(PLAIN_CLIPS, least.tolist(), strict=True):
        found = f"least PSNR of {len(clip)} frames; mean of the samples is exact"
        remedy = "return the mean of the samples where they have no variance"
        yield judge(stressed_method.name, NAME, test, score, PLAIN_PSNR, found, remedy)


def _crop(frame: Frame, shift: int, h: int, w: int) -> Frame:
    """The window of h x w pixels that begins `shift` pixels from the left and the top."""
    window = (..., slice(shift, shift + h), slice(shift, shift + w))
    return edit_tensors(frame, lambda tensor: tensor[window])


def _mean(scores: Iterator[torch.Tensor]) -> float:
    return float(torch.stack(list(scores)).mean())


SECTION = MethodSection(
    NAME, "Does the error stay the same under exposure, flips, shifts and sudden events?", run
)

"""Section transformations: changes of a clip that must not change the error, and sudden events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.display import psnr, psnr_of_frames
from rlbench.checks.frame_edits import (
    edit_radiance,
    edit_tensors,
    join_clips,
    select_clip,
    start_new_shot,
    to_clip,
    with_buffers,
)
from rlbench.checks.result import CheckResult, Limits, judge, not_applicable
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.checks.stress.wrappers import RecordDensity, ReplayDensity, ReversedSamples
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size

SEED, EVENT_SEED = 7300, 7400
SIZE, QUICK_SIZE = Size(3, 32, 48), Size(1, 16, 24)  # adaptive counts differ: several clips
EVENT_SIZE = Size(2, 32, 48)
FRAMES, QUICK_FRAMES = 4, 3
EXPOSURES = (1e-4, 1e-2, 1e2, 1e4)  # factors on radiance
CHANNELS = (1, 2, 0)  # red gets green, green blue, blue red
SHIFTS = (0, 1, 5, 8, 15)  # pixels, along both axes; networks and autoexposure have tiles of 16
MARGIN = 8  # pixels at the border of each crop, which lack context and are not compared
GREY = 0.5  # radiance and albedo of the constant clip
WALL_DEPTH = 3.0  # metres
SKY_RADIANCE = (0.5, 0.7, 1.0)
BEFORE = 4  # frames before an event
AFTER, QUICK_AFTER = 9, 3  # frames from the event on
FLASH_FACTOR = 100.0
RECOVERED_DB = 1.0  # dB of loss at which a frame counts as recovered

# The error is the same by symmetry. 0.5 dB covers rounding of sample counts at other pixels.
SYMMETRY_LOSS = Limits(good=0.5, fair=2.0, unit="dB")
# PSNR between both images. Above 58.9 dB they are equal in 8 bits; at 40 dB the change is visible.
ORDER_PSNR = Limits(good=58.9, fair=40.0, unit="dB")
# There is no noise to remove. At 40 dB an error is just visible, at 30 dB it is obvious.
PLAIN_PSNR = Limits(good=40.0, fair=30.0, unit="dB")
# A marked event leaves nothing of the history: the image equals that of a first frame.
MARKED_LOSS = Limits(good=0.1, fair=1.0, unit="dB")
# Where no buffer says so, a method can still compare samples and surfaces with its history.
# 1 dB is hardly visible for a frame, 3 dB are twice the error.
UNMARKED_LOSS = Limits(good=1.0, fair=3.0, unit="dB")
# At 30 frames per second, 5 frames are the 170 ms in which a change masks errors.
RECOVERY = Limits(good=1.0, fair=5.0, unit="frames")

EVENTS = ("flash", "flash-recovery", "teleport-marked", "teleport", "teleport-recovery")
DETECT = "compare new samples with the history, and drop the history where they contradict it"


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """All tests of one method."""
    size, frames = (QUICK_SIZE, QUICK_FRAMES) if is_quick else (SIZE, FRAMES)
    clip = to_clip(procedural_clip(SEED, size, frames, device=stressed.device))
    yield from _judge_symmetries(stressed, clip)
    yield _judge_shifts(stressed, size, frames)
    yield _judge_sample_order(stressed, clip)
    yield from _judge_plain(stressed, clip)
    if stressed.keeps_state:
        size, after = (QUICK_SIZE, QUICK_AFTER) if is_quick else (EVENT_SIZE, AFTER)
        yield from _judge_flash(stressed, size, after)
        yield from _judge_teleports(stressed, size, after)
    else:
        for test in EVENTS:
            yield not_applicable(test, "keeps no state: Traits(temporal=False)")


# Symmetries of rendering


@dataclass(frozen=True)
class Symmetry:
    """An edit of frames, the inverse edit of images, and the remedy if it changes the error.

    `figure` is what counts of the dB lost: a gain by a mirror shows a preference as well.
    """

    edit: Callable[[Frame], Frame]
    undo: Callable[[Tensor], Tensor]
    remedy: str = ""
    figure: Callable[[float], float] = abs


def _scale_radiance(frame: Frame, factor: float) -> Frame:
    return edit_radiance(frame, lambda radiance: factor * radiance)


def _permute(frame: Frame) -> Frame:
    """Radiance and albedo with permuted channels."""
    permuted = edit_radiance(frame, lambda radiance: radiance[..., CHANNELS, :, :])
    return with_buffers(permuted, albedo=frame.gbuffer.albedo[:, CHANNELS])


def _flip(frame: Frame, image_dim: int, motion_channel: int, normal_channel: int) -> Frame:
    """The mirrored image, as a camera sees the world mirrored along one of its axes.

    World x is mirrored for left and right, world z for up and down, so normals and motion change
    sign along that axis.
    """
    flipped = edit_tensors(frame, lambda tensor: tensor.flip(image_dim))
    motion, normal = flipped.gbuffer.buffers["motion"].clone(), flipped.gbuffer.normal.clone()
    motion[:, motion_channel] *= -1
    normal[:, normal_channel] *= -1
    return with_buffers(flipped, motion=motion, normal=normal)


def _divide(image: Tensor, factor: float) -> Tensor:
    return image / factor


IDENTITY = Symmetry(edit=lambda frame: frame, undo=lambda image: image)
SYMMETRIES = {
    f"exposure-{factor:.0e}": Symmetry(
        partial(_scale_radiance, factor=factor),
        partial(_divide, factor=factor),
        "divide radiance by an exposure before any constant, threshold or clamp, and multiply the "
        "image by it",
        figure=float,
    )
    for factor in EXPOSURES
}
SYMMETRIES |= {
    "channels-permuted": Symmetry(
        _permute,
        lambda image: image[:, [CHANNELS.index(channel) for channel in range(3)]],
        "permute colour channels at random in training",
    ),
    "flip-horizontal": Symmetry(
        partial(_flip, image_dim=-1, motion_channel=0, normal_channel=0),
        partial(torch.flip, dims=(-1,)),
        "flip training clips at random, with motion and normals",
    ),
    "flip-vertical": Symmetry(
        partial(_flip, image_dim=-2, motion_channel=1, normal_channel=2),
        partial(torch.flip, dims=(-2,)),
        "flip training clips at random, with motion and normals",
    ),
}


def _judge_symmetries(stressed: StressedMethod, clip: InMemoryClip) -> Iterator[CheckResult]:
    """The change in dB by an edit that is undone in the image; all edits run in one batch."""
    symmetries = {"original": IDENTITY, **SYMMETRIES}
    edited = [[each.edit(frame) for frame in clip] for each in symmetries.values()]
    results = stressed.run(join_clips(edited))
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
            yield judge(test, figure, SYMMETRY_LOSS, found, symmetry.remedy)


def _judge_shifts(stressed: StressedMethod, size: Size, frames: int) -> CheckResult:
    """The spread of PSNR of one region in crops that begin at other pixels."""
    extent, (n, h, w) = max(SHIFTS), size
    h, w = (side + extent + 2 * MARGIN for side in (h, w))  # all crops share a region of `size`
    large_size = Size(n, h + extent, w + extent)
    large = procedural_clip(SEED, large_size, frames, device=stressed.device)
    crops = [[_crop(frame, shift, h, w) for frame in large] for shift in SHIFTS]
    results = stressed.run(join_clips(crops))
    scores = {}
    for i, shift in enumerate(SHIFTS):
        inner = slice(extent - shift + MARGIN, -shift - MARGIN)  # the region that all crops share
        region = (slice(i * n, (i + 1) * n), slice(None), inner, inner)
        scores[shift] = _mean(
            psnr(result.image[region], result.frame.reference.mean[region]) for result in results
        )
    found = ", ".join(f"{shift} px {score:.2f} dB" for shift, score in scores.items())
    spread = max(scores.values()) - min(scores.values())
    remedy = "pad instead of tiling, and take statistics over overlapping windows"
    return judge("sub-tile-shift", spread, SYMMETRY_LOSS, found, remedy)


def _crop(frame: Frame, shift: int, h: int, w: int) -> Frame:
    """The window of h x w pixels that begins `shift` pixels from the left and the top."""
    window = (..., slice(shift, shift + h), slice(shift, shift + w))
    return edit_tensors(frame, lambda tensor: tensor[window])


def _judge_sample_order(stressed: StressedMethod, clip: InMemoryClip) -> CheckResult:
    """PSNR between the images from the same samples in another order, with the densities held."""
    recorded = RecordDensity(stressed.method)
    spp = max(stressed.default_spp, min(4.0, stressed.traits.spp_range[1]))
    results = stressed.run(clip, spp, recorded)
    held = ReplayDensity.of(ReversedSamples(stressed.method), recorded.densities)
    pairs = zip(results, stressed.run(clip, spp, held), strict=True)
    worst = min(float(psnr(one.image, other.image).min()) for one, other in pairs)
    found = f"PSNR between the images, least of {len(clip)} frames, {spp:g} spp"
    remedy = "treat samples as a set: sum or average over them, without weights by their position"
    return judge("sample-order", worst, ORDER_PSNR, found, remedy)


# Clips without noise or detail


def _fill(
    frame: Frame,
    radiance: tuple[float, float, float],
    albedo: float,
    normal: tuple[float, float, float],
    depth: float,
) -> Frame:
    """The frame with one value per channel everywhere, and no motion."""
    buffers = frame.gbuffer.buffers
    colour = buffers["albedo"].new_tensor(radiance).view(3, 1, 1)
    return with_buffers(
        edit_radiance(frame, lambda tensor: colour.expand_as(tensor).contiguous()),
        albedo=torch.full_like(buffers["albedo"], albedo),
        normal=torch.zeros_like(buffers["normal"]) + colour.new_tensor(normal).view(3, 1, 1),
        depth=torch.full_like(buffers["depth"], depth),
        motion=torch.zeros_like(buffers["motion"]),
    )


PLAIN_CLIPS: dict[str, Callable[[Frame], Frame]] = {
    "black": lambda frame: edit_radiance(frame, torch.zeros_like),
    # a grey wall that fills the image, in even light
    "constant": lambda frame: _fill(frame, (GREY,) * 3, GREY, (0.0, -1.0, 0.0), WALL_DEPTH),
    "sky-only": lambda frame: _fill(frame, SKY_RADIANCE, 0.0, (0.0, 0.0, 0.0), torch.inf),
}


def _judge_plain(stressed: StressedMethod, clip: InMemoryClip) -> Iterator[CheckResult]:
    """The least PSNR of clips without noise."""
    first = [select_clip(frame, 0) for frame in clip]
    batch = join_clips([list(map(make, first)) for make in PLAIN_CLIPS.values()])
    least = psnr_of_frames(stressed.run(batch)).amin(0)
    for test, score in zip(PLAIN_CLIPS, least.tolist(), strict=True):
        found = f"least PSNR of {len(clip)} frames; mean of the samples is exact"
        remedy = "return the mean of the samples where they have no variance"
        yield judge(test, score, PLAIN_PSNR, found, remedy)


# Sudden events: a flash of one frame, and a teleport of the camera


def _judge_flash(stressed: StressedMethod, size: Size, after: int) -> Iterator[CheckResult]:
    """dB lost after a frame in which all light is 100 times as bright, against no such frame."""
    length = BEFORE + 1 + after
    clip = list(procedural_clip(EVENT_SEED, size, length, device=stressed.device))
    flashed = [*clip]
    flashed[BEFORE] = _scale_radiance(clip[BEFORE], FLASH_FACTOR)
    scores = psnr_of_frames(stressed.run(join_clips([clip, flashed])))
    calm, flash = scores.chunk(2, dim=1)
    yield from _judge_losses("flash", (calm - flash).mean(1)[BEFORE + 1 :])


def _judge_teleports(stressed: StressedMethod, size: Size, after: int) -> Iterator[CheckResult]:
    """dB lost after a cut, against a clip that begins there: marked by motion, and unmarked."""
    length = BEFORE + after
    clip = list(procedural_clip(EVENT_SEED, size, length, cut=BEFORE, device=stressed.device))
    marked = [*clip]
    marked[BEFORE] = start_new_shot(clip[BEFORE])
    results = stressed.run(join_clips([clip, marked]))
    unmarked_scores, marked_scores = psnr_of_frames(results)[BEFORE:].chunk(2, dim=1)
    fresh = psnr_of_frames(stressed.run(to_clip(marked[BEFORE:])))
    losses = (fresh - marked_scores).mean(1)
    remedy = "treat motion that points outside the image as the end of all history"
    worst, found = float(losses.max()), _list_losses(losses)
    yield judge("teleport-marked", worst, MARKED_LOSS, found, remedy)
    yield from _judge_losses("teleport", (fresh - unmarked_scores).mean(1))


def _judge_losses(test: str, losses: Float[Tensor, " frames"]) -> Iterator[CheckResult]:
    """The largest loss after an event, and the number of frames until it stays below 1 dB."""
    yield judge(test, float(losses.max()), UNMARKED_LOSS, _list_losses(losses), DETECT)
    affected = (~(losses <= RECOVERED_DB)).nonzero()
    frames = float(affected.max() + 1) if len(affected) else 0.0
    lasting = f"within {RECOVERED_DB:g} dB after {frames:g} of {len(losses)} frames"
    yield judge(f"{test}-recovery", frames, RECOVERY, lasting, DETECT)


def _list_losses(losses: Float[Tensor, " frames"]) -> str:
    return "dB lost per frame: " + ", ".join(f"{loss:.1f}" for loss in losses.tolist())


def _mean(scores: Iterable[Tensor]) -> float:
    return float(torch.stack(list(scores)).mean())


SECTION = MethodSection(run)

"""Finds camera jitter in motion, which then misses by the same part of a pixel everywhere.

The disagreement of a frame is what must be added to its motion, everywhere alike, so that the frame
before lands on it best.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.ops.reprojection import reproject

MAX_FRAMES = 3  # pairs of frames that are compared
STEPS = 8  # of Gauss and Newton
MIN_SIZE = 0.15  # pixels, root of the mean square: less is interpolation and noise, up to 0.11
MAX_SIZE = 2.0  # pixels: more is another fault
MAX_SPREAD = 0.35  # of quarters of the image, relative to the disagreement: more is not jitter
MAX_CONSTANT = 0.6  # share of the disagreements' mean: a constant one is a fault of pixel centres
JITTERED = "reference jitter"  # the limitation of a clip whose reference is jittered too
CROP = 512  # pixels: side of the middle of the image, which suffices
REMEDY = (
    "take it out: with [motion] jittered = true and [camera] jitter in the layout, or by motion of "
    "unjittered matrices"
)


def find_jitter_fault(arrays: ClipArrays) -> str:
    """How motion and reference contradict each other by jitter; empty where they do not.

    With offsets o in clip.toml, motion that contains them misses by -(o(t) - o(t - 1)), a jittered
    reference by the same of the other sign.
    """
    frames = [t for t in range(1, len(arrays)) if t not in arrays.header.cuts][:MAX_FRAMES]
    if len(frames) < 2 or "motion" not in arrays.gbuffer:
        return ""
    found, spreads = frame_disagreements(arrays, frames)
    size = float(found.square().sum(1).mean().sqrt())
    is_uniform = float(spreads.median()) < MAX_SPREAD * size
    if arrays.header.jitter:
        return _compare_with_offsets(arrays, frames, found) if is_uniform or size < MIN_SIZE else ""
    is_constant = float(found.mean(0).norm()) > MAX_CONSTANT * size
    if not MIN_SIZE < size < MAX_SIZE or not is_uniform or is_constant:
        return ""
    return (
        f"differs from the movement of the reference by {size:.2f} pixels, everywhere alike and "
        "otherwise in each frame: motion seems to contain the jitter, or the reference is jittered"
    )


def _compare_with_offsets(arrays: ClipArrays, frames: list[int], found: Tensor) -> str:
    """The fault where offsets are known: their share in the disagreement says what it is."""
    offsets = torch.tensor(arrays.header.jitter)
    changes = torch.stack([offsets[t] - offsets[t - 1] for t in frames])
    power = float(changes.square().sum())
    if math.sqrt(power / len(frames)) < MIN_SIZE:
        return ""
    share = float((found * changes).sum()) / power
    expected = float(JITTERED in arrays.header.limitations)
    if share < expected - 0.5:
        contained = expected - share
        return f"motion seems to contain the jitter: {contained:.0%} of its change between frames"
    if share > expected + 0.5:
        return (
            f"the reference seems to be jittered as the samples are, it moves by {share:.0%} of "
            "the jitter's change: [reference] jittered = true says so"
        )
    return ""


def frame_disagreements(
    arrays: ClipArrays, frames: list[int]
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, " n"]]:
    """For each frame, what its motion lacks on average, and how quarters of it differ; pixels."""
    top, left = (max(side - CROP, 0) // 2 for side in arrays.half_a.shape[-2:])
    middle = (..., slice(top, top + CROP), slice(left, left + CROP))
    reference = arrays.reference[middle]
    image = _blur((reference.clamp_min(0) + 0.1 * reference.mean().clamp_min(1e-9)).log())
    shifts, spreads = [], []
    for t in frames:
        current, previous, motion = (
            image[t, None],
            image[t - 1, None],
            arrays.gbuffer["motion"][t][middle],
        )
        h, w = motion.shape[-2:]
        quarters = [
            (slice(y, y + h // 2), slice(x, x + w // 2)) for y in (0, h // 2) for x in (0, w // 2)
        ]
        everywhere, images = (slice(None), slice(None)), (current, previous, motion)
        shift = _fit_shift(*images, torch.zeros(2), everywhere, STEPS)
        parts = [_fit_shift(*images, shift, region, STEPS // 2) for region in quarters]
        shifts.append(shift)
        spreads.append((torch.stack(parts) - shift).norm(dim=1).median())
    return torch.stack(shifts), torch.stack(spreads)


def _blur(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t c h w"]:
    """The image without what noise and interpolation add between pixels."""
    line = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    kernel = torch.outer(line, line).expand(image.shape[1], 1, 5, 5)
    padded = functional.pad(image, (2, 2, 2, 2), mode="replicate")
    return functional.conv2d(padded, kernel, groups=image.shape[1])


def _fit_shift(
    current: Float[Tensor, "1 c h w"],
    previous: Float[Tensor, "1 c h w"],
    motion: Float[Tensor, "2 h w"],
    start: Float[Tensor, "2"],
    region: tuple[slice, slice],
    steps: int,
) -> Float[Tensor, "2"]:
    """The shift that added to motion aligns the frames in a region (Lucas and Kanade 1981).

    Weights of Cauchy keep disocclusion, gloss and noise from deciding.
    """
    shift = start
    for _ in range(steps):
        warped, inside = reproject(previous, (motion + shift.view(2, 1, 1))[None])
        gradient = torch.stack(torch.gradient(warped[0], dim=(2, 1)))[..., *region]
        residual = (current - warped)[0][..., *region]
        mask = inside[0, 0][region]
        if int(mask.sum()) < 64:
            return start
        scale = residual[:, mask].abs().median().clamp_min(1e-6)
        weight = mask / (1 + (residual / scale).square())
        gram = torch.einsum("achw,bchw,chw->ab", gradient, gradient, weight).double()
        target = torch.einsum("achw,chw,chw->a", gradient, residual, weight).double()
        ridge = 1e-6 * gram.trace().clamp_min(1e-12) * torch.eye(2).double()
        step = torch.linalg.solve(gram + ridge, target).float()
        shift = shift + step.clamp(-0.5, 0.5)
    return shift

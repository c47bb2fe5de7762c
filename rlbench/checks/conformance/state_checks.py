"""Checks of the state: all that a method remembers is in its state, for one clip alone.

A check returns a description of the fault, or None if the method conforms.
"""

from __future__ import annotations

from itertools import chain, zip_longest

import torch
from torch import Tensor

from rlbench.checks.conformance import clips
from rlbench.checks.conformance.interface_checks import find_nonfinite
from rlbench.checks.conformance.method_under_test import MethodUnderTest, RecordedRun
from rlbench.checks.conformance.recording import RecordingMethod
from rlbench.checks.conformance.replay import ReplayCounts, ReplayFromCopy
from rlbench.checks.frame_edits import select_clip, start_new_shot, to_clip
from rlbench.checks.tensors import is_bit_equal
from rlbench.family import Traits
from rlbench.frames import Frame
from rlbench.run import run_clip

TOLERANCE = 1e-3  # relative and absolute: convolutions add in another order for another batch
# size, and float32 values pass through some 20 of them


def check_determinism(method_under_test: MethodUnderTest) -> str | None:
    """Random numbers depend only on the method's arguments."""
    first = method_under_test.default_run.images
    second = method_under_test.run(method_under_test.clip()).images
    if all(map(is_bit_equal, first, second)):
        return None
    difference = _max_difference(first, second)
    return f"expected equal images in a second run, found differences of up to {difference:g}"


def check_interleaved(method_under_test: MethodUnderTest) -> str | None:
    """Frames of another clip in between change nothing."""
    pair = [method_under_test.small_clip(seed) for seed in (clips.SEED, clips.OTHER_SEED)]
    alone = [method_under_test.run(clip).images for clip in pair]
    turns = zip_longest(*(method_under_test.start_run(clip)[0] for clip in pair))
    images = [frame.image for frame in chain.from_iterable(turns)]
    changed = sum(not is_bit_equal(image, alone[i % 2][i // 2]) for i, image in enumerate(images))
    if not changed:
        return None
    found = f"found {changed} of {len(images)} changed by frames of the other clip"
    return f"expected the images of each clip alone, {found}"


def check_batch(method_under_test: MethodUnderTest) -> str | None:
    """Each clip alone equals its part of a batch of two."""
    clip = method_under_test.clip(n=2)
    batch = method_under_test.run(clip)
    frames = list(clip)
    faults = (_compare_to_single(method_under_test, batch, frames, i) for i in range(2))
    return next(filter(None, faults), None)


def check_static(method_under_test: MethodUnderTest) -> str | None:
    """A static clip has no motion buffer, and `gbuffer.motion` is None."""
    clip = method_under_test.small_clip(static=True)
    return find_nonfinite(method_under_test.run(clip).frames)


def check_cut(method_under_test: MethodUnderTest) -> str | None:
    """Where all motion points outside the image, the result equals that of a first frame."""
    *before, last = method_under_test.small_clip()
    first = start_new_shot(last)
    after_cut = method_under_test.run(to_clip([*before, first])).images[-1:]
    alone = method_under_test.run(to_clip([first])).images
    if is_bit_equal(after_cut[0], alone[0]):
        return None
    found = f"found differences of up to {_max_difference(after_cut, alone):g} after another shot"
    return f"expected the image of a first frame, {found}"


def check_temporal(method_under_test: MethodUnderTest) -> str | None:
    """Without a state, a frame does not depend on earlier frames."""
    run = method_under_test.default_run
    alone = method_under_test.run(to_clip([run.frames[-1].frame])).images
    if is_bit_equal(alone[0], run.images[-1]):
        return None
    found = f"found differences of up to {_max_difference(alone, run.images[-1:]):g}"
    return f"expected the same image without earlier frames, {found}"


def skip_temporal(traits: Traits) -> str | None:
    """Why `check_temporal` does not apply, or None."""
    return "Traits(temporal=True)" if traits.temporal else None


def check_state_copy(method_under_test: MethodUnderTest) -> str | None:
    """Stress tests swap, corrupt and reset the state; the latency measurement reuses it."""
    method = ReplayFromCopy(RecordingMethod(method_under_test.method))
    list(run_clip(method, method_under_test.small_clip(), method_under_test.default_spp))
    if not method.changed:
        return None
    found = " and ".join(sorted(method.changed))
    return f"expected equal results from a copied state, found another {found}"


def _compare_to_single(
    method_under_test: MethodUnderTest, batch: RecordedRun, frames: list[Frame], i: int
) -> str | None:
    """How clip `i` of a batch differs from the same clip alone, or None.

    The clip alone gets the sample counts of the batch, because the last bit of a density can change
    them.
    """
    recording = RecordingMethod(method_under_test.method)
    method = ReplayCounts(recording, [counts[i : i + 1] for counts in batch.recording.counts])
    single = to_clip([select_clip(frame, i) for frame in frames])
    images = [frame.image for frame in run_clip(method, single, method_under_test.default_spp)]
    for name, batched, alone in (
        ("images", batch.images, images),
        ("densities", batch.recording.densities, recording.densities),
    ):
        item = [tensor[i : i + 1] for tensor in batched]
        if not all(map(_is_close, item, alone)):
            found = f"found differences of up to {_max_difference(item, alone):g} in clip {i} of 2"
            return f"expected {name} within {TOLERANCE:g} of those of each clip alone, {found}"
    return None


def _is_close(one: Tensor, other: Tensor) -> bool:
    if one.shape != other.shape:
        return False
    return torch.allclose(
        one.double(), other.double(), rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True
    )


def _max_difference(some: list[Tensor], others: list[Tensor]) -> float:
    """The largest absolute difference; NaN where shapes differ."""
    pairs = list(zip(some, others, strict=True))
    if any(one.shape != other.shape for one, other in pairs):
        return float("nan")
    return max(float((one - other).abs().max()) for one, other in pairs)

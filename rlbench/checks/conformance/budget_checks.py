"""Checks of the budget: exact sample counts, supported budgets, and no access to other samples.

A check returns a description of the fault, or None if the method conforms.
"""

from __future__ import annotations

from rlbench.checks.conformance import clips
from rlbench.checks.conformance.interface_checks import find_nonfinite
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.frame_edits import to_clip
from rlbench.checks.tensors import is_bit_equal
from rlbench.family import Traits

SMALL_POOL_SPP = 2  # samples per pixel in a small pool
LOWEST_SPP = 0.01  # samples per pixel: tried in place of a lower limit of zero


def check_budget(method_under_test: MethodUnderTest) -> str | None:
    """Methods are compared at equal sample counts."""
    frames = method_under_test.default_run.frames
    counts = [int(frame.samples.counts.sum()) for frame in frames]
    spp, size = method_under_test.default_spp, method_under_test.size
    expected = round(spp * size.h * size.w)
    if counts == [expected] * clips.FRAMES:
        return None
    return f"expected {expected} samples per frame ({spp:g} spp), found {counts}"


def check_leak(method_under_test: MethodUnderTest) -> str | None:
    """With NaN as the reference and as all undrawn samples, the images stay the same."""
    first = method_under_test.default_run
    frames = [clips.with_nan_reference(frame) for frame in first.frames]
    second = method_under_test.run(to_clip(frames))
    changed = sum(not same for same in map(is_bit_equal, first.images, second.images))
    if not changed:
        return None
    replaced = "the reference and all undrawn samples are NaN"
    return f"expected equal images, found {changed} of {len(frames)} changed when {replaced}"


def check_spp_range(method_under_test: MethodUnderTest) -> str | None:
    """The lowest and the highest budget, and half a sample above the lowest."""
    low, high = method_under_test.traits.spp_range
    high = min(high, float(clips.POOL_SPP))
    first_frame = to_clip(method_under_test.small_clip().frames[:1])
    for spp in dict.fromkeys((max(low, LOWEST_SPP), min(low + 0.5, high), high)):
        try:
            run = method_under_test.run(first_frame, spp)
        except Exception as error:
            error.add_note(f"at {spp:g} spp")
            raise
        if fault := find_nonfinite(run.frames):
            return f"{fault} at {spp:g} spp"
    return None


def check_zero_samples(method_under_test: MethodUnderTest) -> str | None:
    """History, albedo and normals are available without samples."""
    return find_nonfinite(method_under_test.run(method_under_test.small_clip(), 0.0).frames)


def skip_lower_limit(traits: Traits) -> str | None:
    """Why `check_zero_samples` does not apply, or None."""
    low, _ = traits.spp_range
    return f"Traits(spp_range=...) begins at {low:g} spp" if low > 0 else None


def check_small_pool(method_under_test: MethodUnderTest) -> str | None:
    """Clips differ in their number of stored samples."""
    clip = method_under_test.small_clip(pool_spp=SMALL_POOL_SPP)
    spp = _nearest_to_one_spp(method_under_test.traits)
    return find_nonfinite(method_under_test.run(clip, spp).frames)


def skip_above_small_pool(traits: Traits) -> str | None:
    """Why `check_small_pool` does not apply, or None."""
    if _nearest_to_one_spp(traits) <= SMALL_POOL_SPP:
        return None
    return f"Traits(spp_range=...) begins at {traits.spp_range[0]:g} spp"


def _nearest_to_one_spp(traits: Traits) -> float:
    low, high = traits.spp_range
    return min(max(1.0, low), high)

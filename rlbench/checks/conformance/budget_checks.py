"""Claims of samples: what a method buys, which budgets it takes, and what it may not see."""

from __future__ import annotations

from rlbench.checks.conformance import clips
from rlbench.checks.conformance.interface_checks import unsound
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.recording import same
from rlbench.checks.result import Finding, moot, wrong

FEW = 2  # samples of each pixel in a short pool
LEAST = 0.01  # samples per pixel: the budget of a method without a lower limit that is not zero


def budget(subject: MethodUnderTest) -> Finding | None:
    """Neither more nor less: methods are compared at equal samples."""
    bought = [int(each.samples.counts.sum()) for each in subject.default_run.shown]
    asked = round(subject.budget * subject.size.h * subject.size.w)
    if bought == [asked] * clips.FRAMES:
        return None
    return wrong(f"{bought} samples in {clips.FRAMES} frames, {asked} asked for in each")


def leak(subject: MethodUnderTest) -> Finding | None:
    """With NaN for reference and unbought samples the images are what they were."""
    first = subject.default_run
    again = subject.run(clips.clip_of([clips.with_nan_reference(each) for each in first.shown]))
    if all(map(same, first.images, again.images)):
        return None
    return wrong("images change where the reference and the samples that it did not buy are NaN")


def spread(subject: MethodUnderTest) -> Finding | None:
    """Its lowest and highest budget, and one that is no whole number above the lowest."""
    low, high = subject.traits.spp_range
    high = min(high, float(clips.POOL))
    first = clips.clip_of(subject.small().frames[:1])
    for spp in dict.fromkeys((max(low, LEAST), min(low + 0.5, high), high)):
        try:
            run = subject.run(first, spp)
        except Exception as error:  # whatever it raises is what it says of this budget
            return wrong(f"at {spp:g} spp: {type(error).__name__}: {error}", error)
        if why := unsound(run.shown):
            return wrong(f"at {spp:g} spp, {why}")
    return None


def nothing(subject: MethodUnderTest) -> Finding | None:
    """History, albedo and normals are there all the same."""
    if subject.traits.spp_range[0] > 0:
        return moot(f"it asks for {subject.traits.spp_range[0]:g} spp at least")
    why = unsound(subject.run(subject.small(), 0.0).shown)
    return wrong(why) if why else None


def fewer(subject: MethodUnderTest) -> Finding | None:
    """Clips of others hold what they hold."""
    low, high = subject.traits.spp_range
    spp = min(max(1.0, low), high)
    if spp > FEW:
        return moot(f"it asks for {low:g} spp at least")
    why = unsound(subject.run(subject.small(pool=FEW), spp).shown)
    return wrong(why) if why else None

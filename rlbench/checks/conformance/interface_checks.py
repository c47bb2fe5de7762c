"""Claims of form: how a method is built, what it reads, and what it returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import is_dataclass
from typing import Any

import torch
from torch import Tensor

from rlbench.checks.conformance import clips
from rlbench.checks.conformance.method_under_test import MethodUnderTest, Run
from rlbench.checks.conformance.recording import RecordingMethod, flaw
from rlbench.checks.result import Finding, moot, wrong
from rlbench.run import FrameResult, run_clip, unroll
from rlbench.wrappers import HalfPrecision


def built(subject: MethodUnderTest) -> Finding | None:
    """Its traits are those of its family's table; anything else `registry.method` refuses."""
    if subject.method.traits == subject.traits:
        return None
    return wrong(f"it is built with {subject.method.traits}, and declared with {subject.traits}")


def frozen(subject: MethodUnderTest) -> Finding | None:
    """An attribute that can be set is a memory that the bench cannot see."""
    kind = type(subject.method)
    parameters: Any = getattr(kind, "__dataclass_params__", None)
    if is_dataclass(kind) and parameters.frozen:
        return None
    return wrong(f"it is a {kind.__name__}, which can be written to")


def runs(subject: MethodUnderTest) -> Finding | None:
    """No network halves 77 or 123 pixels without padding."""
    return _shows(subject.default_run)


def small(subject: MethodUnderTest) -> Finding | None:
    """Sides that are smaller than what a network halves to one pixel, or pads by."""
    return _shows(subject.run(clips.world(subject.device, clips.SEED, clips.TINY)))


def image(subject: MethodUnderTest) -> Finding | None:
    """As metrics take it, which would broadcast or round anything else without a word."""
    size = subject.size
    for shown in subject.default_run.shown:
        found = shown.image
        if found.shape != (1, 3, size.h, size.w) or found.dtype != torch.float32:
            return wrong(f"frame {shown.frame.index} is of {found.dtype} {list(found.shape)}")
    why = unsound(subject.default_run.shown)
    return wrong(why) if why else None


def half(subject: MethodUnderTest) -> Finding | None:
    """Autocast gives convolutions of bfloat16, and leaves the rest to meet them."""
    halved = RecordingMethod(HalfPrecision(subject.method, subject.device))
    why = unsound(list(run_clip(halved, subject.small(), subject.budget)))
    return wrong(why) if why else None


def density(subject: MethodUnderTest) -> Finding | None:
    """What is not finite or is negative cannot be bought."""
    size, watched = subject.size, subject.default_run.watched
    for wished in watched.densities:
        if why := flaw(wished, (1, 1, size.h, size.w)):
            return wrong(why)
    wanted = clips.FRAMES * len(subject.traits.passes)
    if len(watched.densities) != wanted:
        return wrong(f"there are {len(watched.densities)}, wanted {wanted}")
    return None


def uniform(subject: MethodUnderTest) -> Finding | None:
    """Of a stored clip it is given no more samples than uniform sampling needs."""
    if subject.traits.adaptive:
        return moot("it declares that it adapts")
    for wished in subject.default_run.watched.densities:
        if isinstance(wished, Tensor) and bool(wished.max() > wished.min()):
            return wrong(f"one goes from {float(wished.min()):g} to {float(wished.max()):g}")
    return None


def reads(subject: MethodUnderTest) -> Finding | None:
    """What is declared is read from disk or traced, whether or not it is of use."""
    read, declared = subject.default_run.watched.read, subject.traits.inputs
    if read == declared:
        return None
    return wrong(f"it reads {_names(read)}, and declares {_names(declared)}")


def inputs(subject: MethodUnderTest) -> Finding | None:
    """The bench, the trainer and the next pass go on with what it was given."""
    written = subject.default_run.watched.written
    return wrong(f"it changes {_names(written)} in place") if written else None


def graph(subject: MethodUnderTest) -> Finding | None:
    """A state with a graph keeps all frames before it in memory."""
    watched = RecordingMethod(subject.method)
    with torch.inference_mode(False), torch.enable_grad():
        list(unroll(watched, clips.clip_of(subject.small().frames[:2]), subject.budget))
    return (
        wrong(f"gradients would flow through {_names(watched.graphs)}") if watched.graphs else None
    )


def unsound(frames: Sequence[FrameResult]) -> str | None:
    """Which frame has values that are not finite, or None if there is none."""
    for shown in frames:
        if bad := int((~torch.isfinite(shown.image)).sum()):
            told = f"{bad} of {shown.image.numel()} values that are not finite"
            return f"frame {shown.frame.index} has {told}"
    return None


def _shows(run: Run) -> Finding | None:
    """Is there an image of every frame, as large as the frame?"""
    for shown in run.shown:
        wanted, found = shown.frame.reference.half_a.shape, shown.image.shape
        if wanted != found:
            return wrong(f"an image of {list(found)} for a frame of {list(wanted)}")
    return None


def _names(some: set[str] | frozenset[str]) -> str:
    return ", ".join(sorted(some)) or "none"

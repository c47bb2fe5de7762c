"""Checks of the interface: how a method is built, what it reads, and what it returns.

A check returns a description of the fault, or None if the method conforms.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import is_dataclass
from typing import Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.checks.conformance import clips
from rlbench.checks.conformance.method_under_test import MethodUnderTest, RecordedRun
from rlbench.checks.conformance.recording import RecordingMethod
from rlbench.checks.frame_edits import to_clip
from rlbench.checks.returns import Fault, find_density_fault, find_signature_fault
from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.run import FrameResult, run_clip, unroll
from rlbench.sampling import BudgetError
from rlbench.wrappers import HalfPrecision

BUILD = "return a Method from `build`, with the traits of its variant in FAMILY"


def check_built(method_under_test: MethodUnderTest) -> Fault | str | None:
    """Its traits equal those of its family; `registry.load_method` raises for any other fault."""
    build = registry.resolve(registry.load_family(method_under_test.name).build)
    if fault := find_signature_fault(build, "build"):
        return fault
    try:
        method_under_test.method  # noqa: B018 - cached if it can be built
    except PluginError as error:
        return Fault(str(error), BUILD)
    return None


def check_frozen(method_under_test: MethodUnderTest) -> str | None:
    """An attribute that can be set is memory that a benchmark cannot reset."""
    kind = type(method_under_test.method)
    parameters: Any = getattr(kind, "__dataclass_params__", None)
    if is_dataclass(kind) and parameters.frozen:
        return None
    return f"expected a frozen dataclass, found {kind.__name__}, whose attributes can be set"


def check_returns(method_under_test: MethodUnderTest) -> Fault | None:
    """The first two frames, of a size that fits every network; recording checks the returns."""
    for name in ("start", "plan", "denoise"):
        if fault := find_signature_fault(getattr(method_under_test.method, name), name):
            return fault
    clip = clips.make_clip(method_under_test.device, clips.SEED, clips.EVEN_SIZE)
    with suppress(BudgetError):  # which the check of sizes reports
        method_under_test.run(to_clip(clip.frames[:2]))
    return None


def check_odd_size(method_under_test: MethodUnderTest) -> str | None:
    """No strided network fits 77 or 123 pixels without padding."""
    return _find_wrong_size(method_under_test.default_run)


def check_tiny_size(method_under_test: MethodUnderTest) -> str | None:
    """Both sides are smaller than what a network reduces to one pixel, or pads by."""
    clip = clips.make_clip(method_under_test.device, clips.SEED, clips.TINY_SIZE)
    return _find_wrong_size(method_under_test.run(clip))


def check_image(method_under_test: MethodUnderTest) -> str | None:
    """Metrics would broadcast any other shape and round any other type silently."""
    expected = (1, 3, method_under_test.size.h, method_under_test.size.w)
    for frame in method_under_test.default_run.frames:
        image = frame.image
        if image.shape != expected or image.dtype != torch.float32:
            found = f"{image.dtype} {list(image.shape)}"
            return f"expected torch.float32 {list(expected)}, found {found} in {_label(frame)}"
    return find_nonfinite(method_under_test.default_run.frames)


def check_density(method_under_test: MethodUnderTest) -> Fault | str | None:
    """No samples can be allocated by a density that is negative, infinite or NaN."""
    size, densities = method_under_test.size, method_under_test.default_run.recording.densities
    for density in densities:
        if fault := find_density_fault(density, (1, 1, size.h, size.w)):
            return fault
    expected = clips.FRAMES * len(method_under_test.traits.passes)
    if len(densities) != expected:
        return f"expected {expected} densities, found {len(densities)}"
    return None


def check_uniform(method_under_test: MethodUnderTest) -> str | None:
    """A stored clip provides no more samples than uniform sampling needs."""
    for density in method_under_test.default_run.recording.densities:
        if isinstance(density, Tensor) and bool(density.max() > density.min()):
            low, high = float(density.min()), float(density.max())
            return f"expected a constant density, found values from {low:g} to {high:g}"
    return None


def skip_adaptive(traits: Traits) -> str | None:
    """Why `check_uniform` does not apply, or None."""
    return "Traits(adaptive=True)" if traits.adaptive else None


def check_inputs(method_under_test: MethodUnderTest) -> str | None:
    """Every declared buffer is read from disk or rendered, whether it is used or not."""
    read = method_under_test.default_run.recording.buffers_read
    declared = method_under_test.traits.inputs
    if read == declared:
        return None
    return f"expected the inputs that are read ({_join(read)}), found {_join(declared)} declared"


def check_half_precision(method_under_test: MethodUnderTest) -> str | None:
    """Under autocast convolutions return bfloat16, which then meets float32."""
    method = HalfPrecision(method_under_test.method, method_under_test.device)
    clip, spp = method_under_test.small_clip(), method_under_test.default_spp
    return find_nonfinite(list(run_clip(RecordingMethod(method), clip, spp)))


def check_in_place(method_under_test: MethodUnderTest) -> str | None:
    """The benchmark, the trainer and the next pass use the same tensors afterwards."""
    modified = method_under_test.default_run.recording.modified
    return (
        f"expected unmodified arguments, found changes in {_join(modified)}" if modified else None
    )


def check_autograd(method_under_test: MethodUnderTest) -> str | None:
    """A state that requires gradients keeps all earlier frames in memory."""
    recording = RecordingMethod(method_under_test.method)
    clip = to_clip(method_under_test.small_clip().frames[:2])
    with torch.inference_mode(False), torch.enable_grad():
        list(unroll(recording, clip, method_under_test.default_spp))
    if not recording.with_graph:
        return None
    found = f"found an autograd graph in {_join(recording.with_graph)}"
    return f"expected tensors without gradients, {found}"


def find_nonfinite(frames: Sequence[FrameResult]) -> str | None:
    """The first frame whose image has NaN or infinite values, or None."""
    for frame in frames:
        if invalid := int((~torch.isfinite(frame.image)).sum()):
            return (
                f"expected finite values, found {invalid} of {frame.image.numel()} values "
                f"that are NaN or infinite in {_label(frame)}"
            )
    return None


def _find_wrong_size(run: RecordedRun) -> str | None:
    """The first frame whose image is not as large as the frame, or None."""
    for frame in run.frames:
        expected, shape = frame.frame.reference.half_a.shape, frame.image.shape
        if expected != shape:
            found = f"found {list(shape)} in {_label(frame)}"
            return f"expected an image of shape {list(expected)}, {found}"
    return None


def _label(result: FrameResult) -> str:
    return f"frame {result.frame.index}"


def _join(names: Set[str]) -> str:
    return ", ".join(sorted(names)) or "none"

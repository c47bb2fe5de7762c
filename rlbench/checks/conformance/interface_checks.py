"""Checks of the interface: how a method is built, what it reads and returns, and its budgets.

A check returns a description of the fault, or None if the method conforms. They are printed in the
order in which they are defined.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import is_dataclass
from typing import Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.checks.conformance.method_under_test import (
    EVEN_SIZE,
    FRAMES,
    POOL_SPP,
    TINY_SIZE,
    MethodUnderTest,
    RecordedRun,
    RecordingMethod,
    requirement,
)
from rlbench.checks.frame_edits import to_clip
from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.returns import Fault, find_density_fault, find_signature_fault
from rlbench.run import FrameResult, unroll
from rlbench.sampling import BudgetError
from rlbench.system.half_precision import half_dtype
from rlbench.wrappers import HalfPrecision

SMALL_POOL_SPP = 2  # samples per pixel in a small pool
LOWEST_SPP = 0.01  # samples per pixel: tried in place of a lower limit of zero
FINITE = ("built", "odd_size", "image")  # required where other images have to be finite
RETURN_METHOD = "return a Method from `build`, with the traits of its variant in FAMILY"
CORRECT_LINE = "correct the line that raised; --debug prints the whole traceback"
PAD = "pad and crop as in rlbench.ops (pad, crop)"


@requirement("build a Method with the declared traits", CORRECT_LINE, requires=())
def check_built(tested: MethodUnderTest) -> Fault | str | None:
    """Its traits equal those of its family; `registry.load_method` raises for any other fault."""
    build = registry.resolve(registry.load_family(tested.name).build)
    if fault := find_signature_fault(build, "build"):
        return fault
    try:
        tested.method  # noqa: B018 - cached if it can be built
    except PluginError as error:
        return Fault(str(error), RETURN_METHOD)
    return None


@requirement(
    "be a frozen dataclass",
    "decorate the class with @dataclass(frozen=True) and return memory as the state",
    requires=("built",),
)
def check_frozen(tested: MethodUnderTest) -> str | None:
    """An attribute that can be set is memory that a benchmark cannot reset."""
    kind = type(tested.method)
    parameters: Any = getattr(kind, "__dataclass_params__", None)
    if is_dataclass(kind) and parameters.frozen:
        return None
    return f"expected a frozen dataclass, found {kind.__name__}, whose attributes can be set"


@requirement(
    "return a density from `plan`, and an image and a state from `denoise`",
    CORRECT_LINE,
    requires=("built",),
)
def check_returns(tested: MethodUnderTest) -> Fault | None:
    """The first two frames, of a size that fits every network; recording checks the returns."""
    for name in ("start", "plan", "denoise"):
        if fault := find_signature_fault(getattr(tested.method, name), name):
            return fault
    with suppress(BudgetError):  # which the check of sizes reports
        tested.run(to_clip(tested.clip(EVEN_SIZE).frames[:2]))
    return None


@requirement(
    "run on frames of 77 x 123 pixels",
    f"support any size ({PAD}) and any budget within Traits(spp_range=...)",
    requires=("built", "returns"),
)
def check_odd_size(tested: MethodUnderTest) -> str | None:
    """No strided network fits 77 or 123 pixels without padding."""
    return _find_wrong_size(tested.default_run)


@requirement("run on frames of 9 x 13 pixels", PAD)
def check_tiny_size(tested: MethodUnderTest) -> str | None:
    """Both sides are smaller than what a network reduces to one pixel, or pads by."""
    return _find_wrong_size(tested.run(tested.clip(TINY_SIZE)))


@requirement(
    "return images of finite linear radiance in float32",
    "end with .float(), and clamp divisors, e.g. x / y.clamp_min(1e-6)",
)
def check_image(tested: MethodUnderTest) -> str | None:
    """Metrics would broadcast any other shape and round any other type silently."""
    expected = (1, 3, tested.size.h, tested.size.w)
    for frame in tested.default_run.frames:
        image = frame.image
        if image.shape != expected or image.dtype != torch.float32:
            found = f"{image.dtype} {list(image.shape)} in frame {frame.frame.index}"
            return f"expected torch.float32 {list(expected)}, found {found}"
    return find_nonfinite(tested.default_run.frames)


@requirement(
    "return one finite, non-negative density per pass",
    "return values >= 0 of shape [n 1 h w] from `plan`; their scale does not matter",
)
def check_density(tested: MethodUnderTest) -> Fault | str | None:
    """No samples can be allocated by a density that is negative, infinite or NaN."""
    densities = tested.default_run.recording.densities
    for density in densities:
        if fault := find_density_fault(density, (1, 1, tested.size.h, tested.size.w)):
            return fault
    expected = FRAMES * len(tested.traits.passes)
    if len(densities) != expected:
        return f"expected {expected} densities, found {len(densities)}"
    return None


@requirement(
    "return a constant density unless declared adaptive",
    "declare Traits(adaptive=True), or return torch.ones_like(...) from `plan`",
    skip_reason=lambda traits: "Traits(adaptive=True)" if traits.adaptive else None,
)
def check_uniform(tested: MethodUnderTest) -> str | None:
    """A stored clip provides no more samples than uniform sampling needs."""
    for density in tested.default_run.recording.densities:
        if isinstance(density, Tensor) and bool(density.max() > density.min()):
            low, high = float(density.min()), float(density.max())
            return f"expected a constant density, found values from {low:g} to {high:g}"
    return None


@requirement(
    "declare exactly the G-buffer inputs that are read",
    "declare Traits(inputs=frozenset({...})) with the buffers that are read",
)
def check_inputs(tested: MethodUnderTest) -> str | None:
    """Every declared buffer is read from disk or rendered, whether it is used or not."""
    read, declared = tested.default_run.recording.buffers_read, tested.traits.inputs
    if read == declared:
        return None
    return f"expected the inputs that are read ({_join(read)}), found {_join(declared)} declared"


@requirement(
    "run in half precision (autocast)",
    "call .float() on the output of each network before combining it with float32 tensors",
    requires=(*FINITE, "density"),
)
def check_half_precision(tested: MethodUnderTest) -> str | None:
    """Under autocast convolutions return halves, which then meet float32."""
    method = RecordingMethod(HalfPrecision(tested.method, tested.device, half_dtype(tested.device)))
    return find_nonfinite(list(tested.run_with(method, tested.small_clip())))


@requirement(
    "leave gbuffer, samples and state unmodified",
    "return a new state; use operations without a trailing underscore, or .clone() first",
)
def check_in_place(tested: MethodUnderTest) -> str | None:
    """The benchmark, the trainer and the next pass use the same tensors afterwards."""
    if modified := tested.default_run.recording.modified:
        return f"expected unmodified arguments, found changes in {_join(modified)}"
    return None


@requirement(
    "return tensors without an autograd graph",
    "call .eval().requires_grad_(False) on networks in `build`",
)
def check_autograd(tested: MethodUnderTest) -> str | None:
    """A state that requires gradients keeps all earlier frames in memory."""
    recording = RecordingMethod(tested.method)
    clip = to_clip(tested.small_clip().frames[:2])
    with torch.inference_mode(False), torch.enable_grad():
        list(unroll(recording, clip, tested.default_spp))
    if not recording.with_graph:
        return None
    found = f"found an autograd graph in {_join(recording.with_graph)}"
    return f"expected tensors without gradients, {found}"


@requirement("draw exactly the budget", "let Traits(passes=...) end with 1.0")
def check_budget(tested: MethodUnderTest) -> str | None:
    """Methods are compared at equal sample counts."""
    counts = [int(frame.samples.counts.sum()) for frame in tested.default_run.frames]
    expected = round(tested.default_spp * tested.size.h * tested.size.w)
    if counts == [expected] * FRAMES:
        return None
    return f"expected {expected} samples per frame ({tested.default_spp:g} spp), found {counts}"


@requirement(
    "run at the lowest and highest supported budget, and between",
    "set Traits(spp_range=...) to the supported budgets, given min_samples and max_samples",
    FINITE,
)
def check_spp_range(tested: MethodUnderTest) -> str | None:
    """The lowest and the highest budget, and half a sample above the lowest."""
    low, high = tested.traits.spp_range
    high = min(high, float(POOL_SPP))
    first_frame = to_clip(tested.small_clip().frames[:1])
    for spp in dict.fromkeys((max(low, LOWEST_SPP), min(low + 0.5, high), high)):
        try:
            run = tested.run(first_frame, spp)
        except Exception as error:
            error.add_note(f"at {spp:g} spp")
            raise
        if fault := find_nonfinite(run.frames):
            return f"{fault} at {spp:g} spp"
    return None


def _skip_above(traits: Traits, spp: float) -> str | None:
    """Why a check at no more than `spp` samples per pixel does not apply, or None."""
    low, _ = traits.spp_range
    return f"Traits(spp_range=...) begins at {low:g} spp" if low > spp else None


@requirement(
    "run without samples unless a minimum budget is declared",
    "use samples.mean or divide by counts.clamp_min(1), or set Traits(spp_range=...)",
    FINITE,
    lambda traits: _skip_above(traits, 0.0),
)
def check_zero_samples(tested: MethodUnderTest) -> str | None:
    """History, albedo and normals are available without samples."""
    return find_nonfinite(tested.run(tested.small_clip(), 0.0).frames)


@requirement(
    "run on a pool of two samples per pixel",
    "read the number of sample slots from samples.radiance.shape[1]",
    FINITE,
    lambda traits: _skip_above(traits, SMALL_POOL_SPP),
)
def check_small_pool(tested: MethodUnderTest) -> str | None:
    """Clips differ in their number of stored samples."""
    clip = tested.small_clip(pool_spp=SMALL_POOL_SPP)
    return find_nonfinite(tested.run(clip, tested.traits.nearest_spp(1.0)).frames)


def find_nonfinite(frames: Sequence[FrameResult]) -> str | None:
    """The first frame whose image has NaN or infinite values, or None."""
    for frame in frames:
        if invalid := int((~torch.isfinite(frame.image)).sum()):
            return (
                f"expected finite values, found {invalid} of {frame.image.numel()} values "
                f"that are NaN or infinite in frame {frame.frame.index}"
            )
    return None


def _find_wrong_size(run: RecordedRun) -> str | None:
    """The first frame whose image is not as large as the frame, or None."""
    for frame in run.frames:
        expected, shape = frame.frame.reference.half_a.shape, frame.image.shape
        if expected != shape:
            found = f"found {list(shape)} in frame {frame.frame.index}"
            return f"expected an image of shape {list(expected)}, {found}"
    return None


def _join(names: Set[str]) -> str:
    return ", ".join(sorted(names)) or "none"

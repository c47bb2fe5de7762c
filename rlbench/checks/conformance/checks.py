"""The list of all conformance checks, in the order in which they are printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rlbench.checks.conformance import (
    budget_checks,
    interface_checks,
    locality_checks,
    state_checks,
)
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.returns import Fault
from rlbench.family import Traits

__all__ = ["CHECKS", "Check"]


def _always_applies(traits: Traits) -> str | None:
    """No reason to skip the check."""


@dataclass(frozen=True)
class Check:
    """A requirement of every method, how it is tested, and how to meet it."""

    name: str
    requirement: str  # in the imperative, as printed
    remedy: str  # where a fault brings none of its own
    find_fault: Callable[[MethodUnderTest], Fault | str | None]
    requires: tuple[str, ...] = ("built", "odd_size")  # skipped unless these checks pass
    skip_reason: Callable[[Traits], str | None] = _always_applies


_FINITE = ("built", "odd_size", "image")  # required where other images have to be finite
_COMPARED = ("built", "odd_size", "determinism")  # required where two runs are compared
_STATE = "keep all memory in the returned state, none in the method or in modules"
_PAD = "pad and crop as in rlbench.ops (pad, crop)"
_SPP_RANGE = "set Traits(spp_range=...) to the supported budgets, given min_samples and max_samples"

_ALL = (
    Check(
        "built",
        "build a Method with the declared traits",
        "correct the line that raised; --debug prints the whole traceback",
        interface_checks.check_built,
        requires=(),
    ),
    Check(
        "frozen",
        "be a frozen dataclass",
        "decorate the class with @dataclass(frozen=True) and return memory as the state",
        interface_checks.check_frozen,
        requires=("built",),
    ),
    Check(
        "returns",
        "return a density from `plan`, and an image and a state from `denoise`",
        "correct the line that raised; --debug prints the whole traceback",
        interface_checks.check_returns,
        requires=("built",),
    ),
    Check(
        "odd_size",
        "run on frames of 77 x 123 pixels",
        f"support any size ({_PAD}) and any budget within Traits(spp_range=...)",
        interface_checks.check_odd_size,
        requires=("built", "returns"),
    ),
    Check(
        "tiny_size",
        "run on frames of 9 x 13 pixels",
        _PAD,
        interface_checks.check_tiny_size,
    ),
    Check(
        "image",
        "return images of finite linear radiance in float32",
        "end with .float(), and clamp divisors, e.g. x / y.clamp_min(1e-6)",
        interface_checks.check_image,
    ),
    Check(
        "density",
        "return one finite, non-negative density per pass",
        "return values >= 0 of shape [n 1 h w] from `plan`; their scale does not matter",
        interface_checks.check_density,
    ),
    Check(
        "uniform",
        "return a constant density unless declared adaptive",
        "declare Traits(adaptive=True), or return torch.ones_like(...) from `plan`",
        interface_checks.check_uniform,
        skip_reason=interface_checks.skip_adaptive,
    ),
    Check(
        "inputs",
        "declare exactly the G-buffer inputs that are read",
        "declare Traits(inputs=frozenset({...})) with the buffers that are read",
        interface_checks.check_inputs,
    ),
    Check(
        "half_precision",
        "run in half precision (bfloat16 autocast)",
        "call .float() on the output of each network before combining it with float32 tensors",
        interface_checks.check_half_precision,
        requires=("built", "odd_size", "image", "density"),
    ),
    Check(
        "in_place",
        "leave gbuffer, samples and state unmodified",
        "return a new state; use operations without a trailing underscore, or .clone() first",
        interface_checks.check_in_place,
    ),
    Check(
        "autograd",
        "return tensors without an autograd graph",
        "call .eval().requires_grad_(False) on networks in `build`",
        interface_checks.check_autograd,
    ),
    Check(
        "budget",
        "draw exactly the budget",
        "let Traits(passes=...) end with 1.0",
        budget_checks.check_budget,
    ),
    Check(
        "spp_range",
        "run at the lowest and highest supported budget, and between",
        _SPP_RANGE,
        budget_checks.check_spp_range,
        _FINITE,
    ),
    Check(
        "zero_samples",
        "run without samples unless a minimum budget is declared",
        "use samples.mean or divide by counts.clamp_min(1), or set Traits(spp_range=...)",
        budget_checks.check_zero_samples,
        _FINITE,
        budget_checks.skip_lower_limit,
    ),
    Check(
        "small_pool",
        "run on a pool of two samples per pixel",
        "read the number of sample slots from samples.radiance.shape[1]",
        budget_checks.check_small_pool,
        _FINITE,
        budget_checks.skip_above_small_pool,
    ),
    Check(
        "determinism",
        "return bit-identical images in a second run",
        f"draw from a seeded torch.Generator; {_STATE}",
        state_checks.check_determinism,
    ),
    Check(
        "leak",
        "use neither the reference nor undrawn samples",
        "use only the arguments gbuffer, samples and state",
        budget_checks.check_leak,
        _COMPARED,
    ),
    Check(
        "batch",
        "treat the clips of a batch independently",
        "reduce over dimensions c, h and w, never over n",
        state_checks.check_batch,
        (*_COMPARED, "density"),
    ),
    Check(
        "interleaved",
        "treat clips that run in turns independently",
        _STATE,
        state_checks.check_interleaved,
        _COMPARED,
    ),
    Check(
        "static",
        "run without motion on static clips",
        "pass gbuffer.motion, which is None there, to rlbench.ops.reproject unchanged",
        state_checks.check_static,
        _FINITE,
    ),
    Check(
        "cut",
        "discard history at cuts",
        "reproject the state with rlbench.ops.reproject_or_fill, which replaces what lay outside",
        state_checks.check_cut,
        _COMPARED,
    ),
    Check(
        "temporal",
        "depend on one frame alone unless declared temporal",
        "declare Traits(temporal=True)",
        state_checks.check_temporal,
        _COMPARED,
        state_checks.skip_temporal,
    ),
    Check(
        "state_copy",
        "return the same results from a copy of the state",
        f"{_STATE}; build the state from tensors and plain values",
        state_checks.check_state_copy,
        _COMPARED,
    ),
    Check(
        "receptive_field",
        "depend on no pixel beyond the receptive field, where one is declared",
        "set Traits(receptive_field=...) to the sum of all filter radii, or to None; return None "
        "or a named tuple of tensors [n c h w] as the state",
        locality_checks.check_receptive_field,
        _COMPARED,
        locality_checks.skip_without_field,
    ),
)

CHECKS = {check.name: check for check in _ALL}

"""Every claim of the suite, in the order in which they are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rlbench.checks.conformance import budget_checks, interface_checks, state_checks
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.result import Finding

Test = Callable[[MethodUnderTest], Finding | None]  # None where the claim holds


@dataclass(frozen=True)
class Check:
    """What is said of every method, what would do where it fails, and how it is tried."""

    sentence: str
    remedy: str
    test: Test
    depends_on: tuple[str, ...] = ("built", "runs")  # claims without which this one cannot be told

    @property
    def name(self) -> str:
        """The test's name, unique among the claims."""
        return str(getattr(self.test, "__name__", self.test))


_COMPARED = ("built", "runs", "repeats")  # before it is told that two runs are alike
_STATE = "keep what is remembered in the state that is returned, and nowhere else"
_PAD = "pad and crop as rlbench/ops/pad.py"
_SPP = "declare in Traits(spp=...) what it can do; floor and cap are limits too"

_ALL = (
    Check(
        "it is built with the traits that its family declares",
        "build a Method, with the traits of its row in the family's variants",
        interface_checks.built,
        depends_on=(),
    ),
    Check(
        "it is a frozen dataclass",
        "make it a @dataclass(frozen=True), and return what it remembers as its state",
        interface_checks.frozen,
        depends_on=("built",),
    ),
    Check(
        "it runs on frames of 77 x 123 pixels",
        f"take any size ({_PAD}), and any budget within Traits(spp=...)",
        interface_checks.runs,
        depends_on=("built",),
    ),
    Check("it runs on frames of 9 x 13 pixels", _PAD, interface_checks.small),
    Check(
        "it shows finite linear radiance in single precision",
        "end in .float(); clamp what is divided by",
        interface_checks.image,
    ),
    Check(
        "its densities are finite and not negative, one for each pass",
        "return values >= 0, [n 1 h w]; their scale does not matter",
        interface_checks.density,
    ),
    Check(
        "it wants all pixels alike where it declares not to adapt",
        "declare Traits(adaptive=True), or return ones",
        interface_checks.uniform,
    ),
    Check(
        "it reads exactly the view buffers that it declares",
        "declare in Traits(inputs=...) what it reads",
        interface_checks.reads,
    ),
    Check(
        "it runs in half precision too",
        "let no operation meet tensors of two precisions; .float() after a network will do",
        interface_checks.half,
        depends_on=("built", "runs", "image", "density"),
    ),
    Check(
        "it writes to nothing that it is given: view, samples, state",
        "use the operation without a trailing _, or clone first",
        interface_checks.inputs,
    ),
    Check(
        "it holds no autograd graph",
        "call .eval().requires_grad_(False) on its networks where they are built",
        interface_checks.graph,
    ),
    Check(
        "it buys its budget to the sample",
        "let the last of Traits(passes=...) be 1.0",
        budget_checks.budget,
    ),
    Check("it runs at both ends of its range of budgets, and between", _SPP, budget_checks.spread),
    Check(
        "it runs without a single sample where it declares no lower limit",
        "divide by counts.clamp_min(1), as samples.mean does; or declare a limit",
        budget_checks.nothing,
    ),
    Check(
        "it runs on a pool of two samples a pixel",
        "take the number of slots from samples.radiance.shape[1]",
        budget_checks.fewer,
    ),
    Check(
        "it shows the same in a second run, bit for bit",
        "draw from a torch.Generator with a seed of its own; " + _STATE,
        state_checks.repeats,
    ),
    Check(
        "it sees neither the reference nor unbought samples",
        "use no more than view, samples and state",
        budget_checks.leak,
        _COMPARED,
    ),
    Check(
        "it shows two clips at once as each alone",
        "reduce over c, h and w, never over n",
        state_checks.batch,
        (*_COMPARED, "density"),
    ),
    Check("it keeps apart clips that are advanced in turn", _STATE, state_checks.alone, _COMPARED),
    Check(
        "it needs no motion where nothing moves",
        "view.motion is None there, which rlbench/ops/reprojection.py takes",
        state_checks.static,
    ),
    Check(
        "it remembers nothing where another shot begins",
        "move the state by rlbench.ops.reprojection.recall: what comes from outside is missing",
        state_checks.cut,
        _COMPARED,
    ),
    Check(
        "it shows each frame as if alone where it declares no memory",
        "declare Traits(temporal=True)",
        state_checks.temporal,
        _COMPARED,
    ),
    Check(
        "it shows the same again from a copy of its state",
        _STATE + "; let it be of tensors and plain values",
        state_checks.replay,
        _COMPARED,
    ),
)

CHECKS = {claim.name: claim for claim in _ALL}

"""Every claim of the suite, in the order in which they are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rlbench.checks.conformance import budget_checks as bought
from rlbench.checks.conformance import interface_checks as promises
from rlbench.checks.conformance import state_checks as remembered
from rlbench.checks.conformance.method_under_test import Subject
from rlbench.checks.result import Finding

Test = Callable[[Subject], Finding | None]  # None where the claim holds


@dataclass(frozen=True)
class Claim:
    """What is said of every method, what would do where it fails, and how it is tried."""

    sentence: str
    remedy: str
    test: Test
    after: tuple[str, ...] = ("built", "runs")  # claims without which this one cannot be told

    @property
    def name(self) -> str:
        """The test's name, unique among the claims."""
        return str(getattr(self.test, "__name__", self.test))


_COMPARED = ("built", "runs", "repeats")  # before it is told that two runs are alike
_STATE = "keep what is remembered in the state that is returned, and nowhere else"
_PAD = "pad and crop as rlbench/ops/pad.py"
_SPP = "declare in Traits(spp=...) what it can do; floor and cap are limits too"

_ALL = (
    Claim(
        "it is built with the traits that its family declares",
        "build a Method, with the traits of its row in the family's variants",
        promises.built,
        after=(),
    ),
    Claim(
        "it is a frozen dataclass",
        "make it a @dataclass(frozen=True), and return what it remembers as its state",
        promises.frozen,
        after=("built",),
    ),
    Claim(
        "it runs on frames of 77 x 123 pixels",
        f"take any size ({_PAD}), and any budget within Traits(spp=...)",
        promises.runs,
        after=("built",),
    ),
    Claim("it runs on frames of 9 x 13 pixels", _PAD, promises.small),
    Claim(
        "it shows finite linear radiance in single precision",
        "end in .float(); clamp what is divided by",
        promises.image,
    ),
    Claim(
        "its densities are finite and not negative, one for each pass",
        "return values >= 0, [n 1 h w]; their scale does not matter",
        promises.density,
    ),
    Claim(
        "it wants all pixels alike where it declares not to adapt",
        "declare Traits(adapts=True), or return ones",
        promises.uniform,
    ),
    Claim(
        "it reads exactly the view buffers that it declares",
        "declare in Traits(needs=...) what it reads",
        promises.reads,
    ),
    Claim(
        "it runs in half precision too",
        "let no operation meet tensors of two precisions; .float() after a network will do",
        promises.half,
        after=("built", "runs", "image", "density"),
    ),
    Claim(
        "it writes to nothing that it is given: view, samples, state",
        "use the operation without a trailing _, or clone first",
        promises.inputs,
    ),
    Claim(
        "it holds no autograd graph",
        "call .eval().requires_grad_(False) on its networks where they are built",
        promises.graph,
    ),
    Claim(
        "it buys its budget to the sample",
        "let the last of Traits(passes=...) be 1.0",
        bought.budget,
    ),
    Claim("it runs at both ends of its range of budgets, and between", _SPP, bought.spread),
    Claim(
        "it runs without a single sample where it declares no lower limit",
        "divide by counts.clamp_min(1), as samples.mean does; or declare a limit",
        bought.nothing,
    ),
    Claim(
        "it runs on a pool of two samples a pixel",
        "take the number of slots from samples.radiance.shape[1]",
        bought.fewer,
    ),
    Claim(
        "it shows the same in a second run, bit for bit",
        "draw from a torch.Generator with a seed of its own; " + _STATE,
        remembered.repeats,
    ),
    Claim(
        "it sees neither the reference nor unbought samples",
        "use no more than view, samples and state",
        bought.leak,
        _COMPARED,
    ),
    Claim(
        "it shows two clips at once as each alone",
        "reduce over c, h and w, never over n",
        remembered.batch,
        (*_COMPARED, "density"),
    ),
    Claim("it keeps apart clips that are advanced in turn", _STATE, remembered.alone, _COMPARED),
    Claim(
        "it needs no motion where nothing moves",
        "view.motion is None there, which rlbench/ops/reprojection.py takes",
        remembered.static,
    ),
    Claim(
        "it remembers nothing where another shot begins",
        "move the state by rlbench.ops.reprojection.recall: what comes from outside is missing",
        remembered.cut,
        _COMPARED,
    ),
    Claim(
        "it shows each frame as if alone where it declares no memory",
        "declare Traits(temporal=True)",
        remembered.temporal,
        _COMPARED,
    ),
    Claim(
        "it shows the same again from a copy of its state",
        _STATE + "; let it be of tensors and plain values",
        remembered.replay,
        _COMPARED,
    ),
)

CLAIMS = {claim.name: claim for claim in _ALL}

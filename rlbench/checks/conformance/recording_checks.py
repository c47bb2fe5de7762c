"""The check that a frame can be recorded: that nothing in it waits for the values of a tensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode

from rlbench import registry
from rlbench.checks.conformance.method_under_test import MethodUnderTest, requirement
from rlbench.checks.conformance.state_checks import COMPARED
from rlbench.checks.frame_edits import stored_radiance, to_clip
from rlbench.frames import Frame, GBuffer, StoredPool
from rlbench.method import State
from rlbench.ops.nested_tensors import read_leaves, replace_leaves
from rlbench.returns import Fault
from rlbench.run import run_frame
from rlbench.sanitize import sanitize_frame

REMEDY = (
    "use torch.where in place of branches and of indices by mask, or torch.full in place of "
    'torch.tensor; else declare Traits(eager_reason="...")'
)
COPIED = torch.ops.aten.lift_fresh.default  # what torch.tensor does with numbers of the program


class HostConstantError(RuntimeError):
    """A tensor of the program's numbers: a copy from the host, which no recording repeats."""


class _Recording(FakeTensorMode):
    """Tensors that have a shape and no values; a tensor made from numbers is an error."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is COPIED:
            raise HostConstantError("torch.tensor copies numbers from the host")
        return super().__torch_dispatch__(func, types, args, kwargs)  # type: ignore[no-untyped-call]


@requirement(
    "ask no questions of its tensors, or say why",
    REMEDY,
    (*COMPARED, "density", "inputs", "in_place", "autograd", "leak", "state_copy"),
    lambda traits: f"Traits(eager_reason={traits.eager_reason!r})" if traits.eager_reason else None,
)
def check_recordable(tested: MethodUnderTest) -> Fault | None:
    """A frame without a state and one with, on tensors that have a shape and no values."""
    first, second = tested.small_clip().frames[:2]
    states = (tested.method.start(tested.small_size), tested.run(to_clip([first])).frames[0].state)
    try:
        for frame, state in zip((first, second), states, strict=True):
            _record(tested, frame, state)
    except Exception as error:  # whatever the method does with a tensor without values
        return Fault(f"found {registry.failure_reason(tested.name, error)}", REMEDY)
    return None


def _record(tested: MethodUnderTest, frame: Frame, state: State) -> None:
    """Run a frame with fake tensors. Raises what the first question raises."""
    fake = _Recording(allow_non_fake_inputs=True)  # weights are real

    def imitate(values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: fake.from_tensor(value) if isinstance(value, Tensor) else value
            for name, value in values.items()
        }

    with torch.no_grad():
        buffers = imitate(frame.gbuffer.buffers)
        seeds = torch.tensor(frame.pool.rounding_seeds)
        pool = StoredPool(*imitate({"radiance": stored_radiance(frame), "seeds": seeds}).values())
        given = replace(frame, gbuffer=GBuffer(buffers, frame.gbuffer.static), pool=pool)
        state = replace_leaves(state, imitate(dict(read_leaves(state))))
        with fake:
            valid = sanitize_frame(given, tested.traits.inputs)
            run_frame(tested.method, valid, state, tested.default_spp)

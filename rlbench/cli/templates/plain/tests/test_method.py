"""The method keeps the contract, and does what it is for."""

from __future__ import annotations

import pytest

from rlbench import load_method, procedural_clip, run_clip
from rlbench.checks.conformance import CHECKS, MethodUnderTest, run_check

method = MethodUnderTest("$name")  # runs once, for all checks


@pytest.mark.parametrize("check", CHECKS)
def test_the_contract_is_kept(check: str) -> None:
    run_check(method, check).raise_if_failed()


def test_the_error_falls_while_samples_accumulate() -> None:
    clip = procedural_clip(seed=1, frames=4)
    frames = list(run_clip(load_method("$name"), clip, spp=1.0))
    errors = [(x.image - x.frame.reference.mean).abs().mean().item() for x in frames]
    assert errors[-1] < 0.8 * errors[0]

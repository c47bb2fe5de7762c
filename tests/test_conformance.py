"""What every installed method must do: a new one is tested by being installed."""

from __future__ import annotations

import os
from functools import cache

import pytest
import torch

from rlbench import registry
from rlbench.checks.conformance.checks import CHECKS
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import run_check, run_checks
from rlbench.checks.result import Verdict

GIVEN = os.environ.get(registry.VARIABLE, "")  # methods beside the installed ones
METHODS = [
    name if registry.variant(name).pretrained else pytest.param(name, marks=pytest.mark.slow)
    for family in registry.names("methods")
    if not registry.import_error("methods", family)
    for name in registry.family(family).names()
]


@pytest.fixture(autouse=True)
def _given(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(registry.VARIABLE, GIVEN)


@cache
def subject(name: str) -> MethodUnderTest:
    """The method, run once for all claims that can share a run."""
    return MethodUnderTest(name)


@pytest.mark.parametrize("family", registry.names("methods"))
def test_every_installed_family_can_be_loaded(family):
    assert registry.import_error("methods", family) is None


@pytest.mark.parametrize("claim", CHECKS)
@pytest.mark.parametrize("name", METHODS)
def test_every_claim_holds_of_every_method(name, claim):
    finding = run_check(subject(name), claim)
    if finding.verdict is Verdict.MOOT:
        pytest.skip(finding.found)
    told = f"{name}: {CHECKS[claim].sentence}: {finding.found} -> {CHECKS[claim].remedy}"
    if finding.error:
        raise AssertionError(told) from finding.error
    assert finding.verdict is Verdict.HOLDS, told


@pytest.mark.gpu
@pytest.mark.parametrize("name", METHODS)
def test_every_claim_holds_of_every_method_on_a_gpu(name):
    on_gpu = MethodUnderTest(name, torch.device("cuda"))
    wrong = [
        claim.sentence for claim, found in run_checks(on_gpu) if found.verdict is Verdict.FAILS
    ]
    assert wrong == []

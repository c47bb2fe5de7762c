"""Every installed method conforms: a new one is tested by being installed."""

from __future__ import annotations

import os
from functools import cache

import pytest
import torch

from rlbench import registry
from rlbench.checks.conformance import CHECKS, MethodUnderTest, Verdict, run_check, run_checks

LOOSE_PLUGINS = os.environ.get(registry.METHODS_VARIABLE, "")  # methods beside the installed ones
METHODS = [
    name if registry.get_variant(name).pretrained else pytest.param(name, marks=pytest.mark.slow)
    for family in registry.list_plugins("methods")
    if not registry.import_error("methods", family)
    for name in registry.load_family(family).method_names()
]


@pytest.fixture(autouse=True)
def _loose_plugins(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(registry.METHODS_VARIABLE, LOOSE_PLUGINS)


@cache
def method_under_test(name: str) -> MethodUnderTest:
    """The method, run once for all checks that can share a run."""
    return MethodUnderTest(name)


@pytest.mark.parametrize("family", registry.list_plugins("methods"))
def test_every_installed_family_can_be_imported(family):
    assert registry.import_error("methods", family) is None


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("name", METHODS)
def test_every_method_passes_every_check(name, check):
    result = run_check(method_under_test(name), check)
    if result.verdict is Verdict.SKIPPED:
        pytest.skip(result.found)
    result.raise_if_failed()
    assert result.verdict is Verdict.PASSED


@pytest.mark.gpu
@pytest.mark.parametrize("name", METHODS)
def test_every_method_passes_every_check_on_a_gpu(name):
    on_gpu = MethodUnderTest(name, torch.device("cuda"))
    failed = [str(result) for _, result in run_checks(on_gpu) if result.verdict is Verdict.FAILED]
    assert failed == []

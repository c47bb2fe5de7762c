"""Every installed method conforms: a new one is tested by being installed."""

from __future__ import annotations

import pytest
import torch

from rlbench import registry
from rlbench.checks.conformance import MethodUnderTest, Verdict, run_checks
from rlbench.frames import Size

SAME_CODE = {  # training, constants or parts of another row alone tell them from one that is tested
    *("accumulate/intel", "accumulate/tuned", "accumulate/fast", "cross/contrast", "cross/restir"),
    *("oidn/retrained", "oidn/tuned", "oidn-intel/balanced", "oidn-intel/fast", "oidn-intel/clean"),
    *("ours/A1", "ours/latent-A1", "ours/latent-initial", "ours/latent-small", "svgf/falcor"),
    *("ours/paper-A1", "ours/paper-appo"),
}
METHODS = [
    name
    if registry.get_variant(name).pretrained and name not in SAME_CODE
    else pytest.param(name, marks=pytest.mark.slow)
    for family in registry.list_plugins("methods")
    if not registry.import_error("methods", family)
    for name in registry.load_family(family).method_names()
]
SIZE, SMALL_SIZE = Size(1, 45, 61), Size(1, 21, 37)  # odd, and quicker than those of the command


def assert_conforms(tested: MethodUnderTest) -> None:
    if reason := tested.unavailable_reason:
        pytest.skip(reason)
    for check, result in run_checks(tested):
        result.raise_if_failed()
        skipped = check.skip_reason(tested.traits) is not None
        assert result.verdict is (Verdict.SKIPPED if skipped else Verdict.PASSED)


@pytest.mark.parametrize("family", registry.list_plugins("methods"))
def test_every_installed_family_can_be_imported(family):
    assert registry.import_error("methods", family) is None


@pytest.mark.parametrize("name", METHODS)
def test_every_method_passes_every_check(name):
    reaches_far = registry.get_variant(name).traits.receptive_field is not None
    sizes = {} if reaches_far else {"size": SIZE, "small_size": SMALL_SIZE}
    assert_conforms(MethodUnderTest(name, **sizes))


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_every_method_passes_every_check_of_the_command(name):
    assert_conforms(MethodUnderTest(name))


@pytest.mark.gpu
@pytest.mark.parametrize("name", METHODS)
def test_every_method_passes_every_check_on_a_gpu(name):
    assert_conforms(MethodUnderTest(name, torch.device("cuda")))

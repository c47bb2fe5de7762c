import pytest
import torch
from torch import nn

from rlbench.checks.result import Verdict
from rlbench.checks.stress import precision
from rlbench.checks.stress.conversion import convert_method
from tests.checks.stress import broken_methods as broken


def verdicts(method, quick=True):
    results = precision.run(broken.make_stressed_method(method), quick)
    return {result.test: result.verdict for result in results}


def test_the_mean_passes_every_test():
    found = verdicts(broken.Mean())
    found.pop("device")
    assert set(found.values()) == {Verdict.PASSED}


@pytest.mark.parametrize(
    ("method", "test"),
    [
        (broken.Cancels(), "float32"),
        (broken.Cancels(), "float32-worst-pixel"),
        (broken.CancelsInHalf(), "bf16"),
        (broken.CancelsInHalf(), "bf16-worst-pixel"),
        (broken.Unseeded(), "rerun"),
        (broken.DividesByBatch(), "batch"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_a_fault_is_found(method, test):
    assert verdicts(method)[test] is Verdict.FAILED


@pytest.mark.slow
def test_the_full_form_finds_a_dependence_on_threads():
    assert verdicts(broken.DependsOnThreads(), quick=False)["threads"] is Verdict.FAILED
    assert verdicts(broken.Mean(), quick=False)["threads"] is Verdict.PASSED


def test_a_method_that_fails_in_float64_is_skipped_with_the_reason():
    method = broken.make_stressed_method(broken.NeedsFloat32())
    results = {r.test: r for r in precision.run(method, True)}
    assert results["float32"].verdict is Verdict.SKIPPED
    assert "RuntimeError" in results["float32"].found
    assert "against float32" in results["bf16"].found


def test_threads_and_default_dtype_are_restored():
    before = torch.get_num_threads(), torch.get_default_dtype()
    list(precision.run(broken.make_stressed_method(broken.NeedsFloat32()), True))
    assert (torch.get_num_threads(), torch.get_default_dtype()) == before


def test_a_converted_method_is_a_copy():
    method = broken.Mean(hidden={"parts": [nn.Linear(2, 2)], "scale": torch.ones(1)})
    converted = convert_method(method, torch.float64)
    assert converted.hidden["parts"][0].weight.dtype == torch.float64
    assert converted.hidden["scale"].dtype == torch.float64
    assert method.hidden["parts"][0].weight.dtype == torch.float32
    assert method.hidden["scale"].dtype == torch.float32

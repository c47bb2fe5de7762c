"""The section `budgets` finds methods that break at a budget, a density or a size."""

from __future__ import annotations

import pytest
import torch

from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress import budgets
from rlbench.checks.stress.section import load_stressed_method
from tests.checks.stress.broken_methods import stressed_toy

CPU = torch.device("cpu")

SIZES = {"size-1x1", "size-17x1", "size-9x7", "size-123x77"}
TOYS = {  # the fault: body of the denoiser, the tests that find it
    "a division by the number of samples": (
        "return samples.radiance.sum(1) / samples.counts, None",
        {"spp-0", "density-half", "density-1e38"},
    ),
    "an exception without samples": (
        "assert samples.counts.any(); return samples.mean, None",
        {"spp-0"},
    ),
    "a stencil that needs three rows": (
        "return torch.nn.functional.pad(samples.mean, (1, 1, 1, 1), 'reflect')[..., 1:-1, 1:-1], 0",
        {"size-1x1", "size-17x1"},
    ),
    "sizes rounded down to even numbers": (
        "h, w = (side // 2 * 2 for side in samples.mean.shape[2:]); "
        "return samples.mean[..., :h, :w], None",
        SIZES,
    ),
    "an image in double precision": (
        "return samples.mean.double(), None",
        {"spp-0", "spp-2", "spp-8", "density-half", "density-1e38"} | SIZES,
    ),
    "an image that brightens with the budget": (
        "return samples.mean + 0.1 * samples.counts.float().mean(), None",
        {"more-samples"},
    ),
}


def failed_tests(stressed) -> set[str]:
    results = list(budgets.SECTION.run(stressed, True))
    assert len({result.check for result in results}) == len(results)
    return {result.check for result in results if result.verdict is Verdict.FAILED}


@pytest.mark.parametrize("fault", TOYS)
def test_a_broken_method_fails_the_tests_of_its_fault_alone(tmp_path, fault):
    body, expected = TOYS[fault]
    assert failed_tests(stressed_toy(tmp_path, body, "adaptive=True")) == expected


@pytest.mark.parametrize("name", ["mean", "svgf"])
def test_a_sound_method_passes(name):
    assert not failed_tests(load_stressed_method(name, CPU))


@pytest.mark.parametrize(
    ("toy", "test", "verdict", "found"),
    [
        (
            {"traits": "spp_range=(1.0, 8.0)"},
            *("spp-0", Verdict.SKIPPED, "supports 1 to 8 spp, requested 0"),
        ),
        (
            {"body": "return samples.mean + 0.028 * samples.counts.float().mean(), None"},
            *("more-samples", Verdict.WARNING, "largest loss from 2 to 8 spp; 2 spp: "),
        ),
    ],
)
def test_a_toy_gets_a_verdict_with_its_reason(tmp_path, toy, test, verdict, found):
    results = budgets.SECTION.run(stressed_toy(tmp_path, **toy), True)
    (result,) = (result for result in results if result.check == test)
    assert result.verdict is verdict
    assert result.found.startswith(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in registry.expand(["all/*"]) if "/" not in n])
def test_a_shipped_method_runs_at_every_budget_and_size_in_the_full_form(name):
    results = list(budgets.SECTION.run(load_stressed_method(name, CPU), False))
    failed = [r for r in results if r.verdict is Verdict.FAILED and r.check != "more-samples"]
    assert not failed

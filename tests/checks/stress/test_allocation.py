"""The section `allocation` finds an allocation that misses the budget or a limit."""

from __future__ import annotations

import pytest
import torch

from rlbench.checks.result import Verdict
from rlbench.checks.stress import allocation
from rlbench.checks.stress.allocation import DENSITIES
from rlbench.sampling import allocate_counts


def failed_tests() -> set[str]:
    return {r.check for r in allocation.SECTION.run(True) if r.verdict is Verdict.FAILED}


def test_the_allocation_of_this_suite_passes():
    assert not failed_tests()


def in_single_precision(density, total, low, high, seeds):
    """Rounds shares of a sum in float32, which is infinite for densities of 1e38."""
    shares = density * (total / density.sum())
    return shares.nan_to_num().long().clamp(low, torch.full_like(low, high))


def without_a_limit(density, total, low, high, seeds):
    counts = torch.zeros_like(low)
    counts.view(-1)[density.argmax()] = total
    return counts


def one_too_many(density, total, low, high, seeds):
    counts = allocate_counts(density, total, low, high, seeds)
    counts.view(-1)[0] += 1
    return counts


FAULTS = {
    in_single_precision: {"1e38-123x77", "zero-123x77", "one-hot-123x77"},
    without_a_limit: {"one-hot-17x1", "constant-123x77"},
    one_too_many: {"half-1x1", "zero-17x1", "random-123x77"},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_allocation_fails(monkeypatch, fault):
    monkeypatch.setattr(allocation, "allocate_counts", fault)
    assert failed_tests() >= FAULTS[fault]


def test_an_exception_of_the_allocation_is_the_result_of_its_test(monkeypatch):
    monkeypatch.setattr(allocation, "allocate_counts", lambda *_: 1 / 0)
    results = list(allocation.SECTION.run(True))
    assert {result.verdict for result in results} == {Verdict.FAILED}
    assert "raised ZeroDivisionError" in results[0].found


@pytest.mark.parametrize("name", DENSITIES)
def test_a_density_is_finite_at_least_0_and_the_same_every_time(name):
    density = DENSITIES[name](7, 9)
    assert density.shape == (1, 1, 7, 9)
    assert density.dtype == torch.float32
    assert density.isfinite().all()
    assert (density >= 0).all()
    assert torch.equal(density, DENSITIES[name](7, 9))
    is_denormal = 0 < density.max() < torch.finfo(torch.float32).tiny
    assert is_denormal == (name == "denormal")


@pytest.mark.slow
def test_the_allocation_is_exact_up_to_4k():
    assert all(result.verdict is Verdict.PASSED for result in allocation.SECTION.run(False))

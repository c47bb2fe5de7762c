"""Correlations and ratios of noise against known answers."""

from __future__ import annotations

import pytest
import torch

from rlbench.checks.lint.noise_statistics import bounded_noise, correlate, ratio_of_sums


def test_independent_samples_correlate_by_one_over_the_others():
    generator = torch.Generator().manual_seed(0)
    pool = torch.randn(2, 8, 3, 64, 64, generator=generator).exp()
    noise = bounded_noise(pool)
    found, error = correlate(noise[:, 2], noise[:, 5])
    assert found == pytest.approx(-1 / 7, abs=4 * error)
    assert error < 0.02


def test_the_error_of_a_ratio_is_its_scatter_over_seeds():
    generator = torch.Generator().manual_seed(0)
    pairs = [torch.rand(2, 1, 3, 64, 64, generator=generator) for _ in range(60)]
    found = torch.tensor([ratio_of_sums(upper, lower) for upper, lower in pairs])
    # 60 draws give a standard deviation to within 1 / sqrt(120), 9 %; three times that
    assert float(found[:, 0].std() / found[:, 1].mean()) == pytest.approx(1, abs=0.28)

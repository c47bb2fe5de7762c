"""Effort: correlations equal to scipy's, and what they say of known densities."""

from __future__ import annotations

import math

import pytest
import torch
from scipy.stats import spearmanr

from metrics.catalog_video import AT_CAP, EFFORT_ERROR, EFFORT_NOISE
from metrics.effort import at_cap, centre_ranks, effort_error, rank_correlation, scene_noise
from metrics.metric import Comparison


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("levels", [2, 9, 1000])
def test_rank_correlation_equals_that_of_scipy(levels):
    x = torch.randint(0, levels, (3, 1, 15, 17), generator=generator())
    y = (x + torch.randn(x.shape, generator=generator(1)) * levels / 3).round(decimals=1)
    expected = [spearmanr(a.flatten(), b.flatten()).statistic for a, b in zip(x, y, strict=True)]
    # ranks are exact in double precision; the result is rounded to float32
    assert rank_correlation(x, y).tolist() == pytest.approx(expected, abs=1e-6)


def test_equal_counts_correlate_with_nothing():
    counts = torch.full((1, 1, 9, 9), 4)
    error = torch.rand(1, 3, 9, 9, generator=generator())
    assert effort_error(centre_ranks(counts), error).item() == 0
    assert rank_correlation(counts, scene_noise(error, torch.zeros_like(error))).item() == 0


def test_effort_error_is_one_where_most_samples_went_to_the_largest_errors():
    error = torch.rand(1, 3, 12, 12, generator=generator()) - 0.5
    size = error.square().mean(1, keepdim=True)
    counts = (1e6 * size).int()  # so fine that no two pixels share one
    assert effort_error(centre_ranks(counts), error).item() == pytest.approx(1)
    assert effort_error(centre_ranks(10**6 - counts), error).item() == pytest.approx(-1)


def test_a_pixel_that_is_not_finite_has_the_largest_error_of_all():
    counts = torch.arange(16).view(1, 1, 4, 4)
    error = torch.linspace(0, 0.9, 16).view(1, 1, 4, 4).repeat(1, 3, 1, 1)
    assert effort_error(centre_ranks(counts), error).item() == 1
    worst_last = error.clone()
    worst_last[..., 3, 3] = math.nan
    assert effort_error(centre_ranks(counts), worst_last).item() == 1
    worst_first = error.clone()
    worst_first[..., 0, 0] = math.nan
    ranks_apart = 15**2 + 15 * 1**2  # the first of 16 is last, the others are one earlier
    expected = 1 - 6 * ranks_apart / (16 * (16**2 - 1))
    assert effort_error(centre_ranks(counts), worst_first).item() == pytest.approx(expected)


def test_effort_noise_shows_whether_samples_follow_the_noise_of_the_scene():
    spread = torch.linspace(0.001, 0.2, 64).expand(1, 3, 48, 64)
    a, b = (0.5 + spread * torch.randn(spread.shape, generator=generator(i)) for i in (0, 1))
    towards = (torch.linspace(0, 8, 64).round().int()).expand(1, 1, 48, 64)
    random = torch.randint(0, 9, towards.shape, generator=generator(2))
    # the noise of a 7x7 window has 147 numbers, so its relative error is sqrt(2 / 147) = 12 %
    noise = scene_noise(a, b)
    assert rank_correlation(towards, noise).item() > 0.95
    assert rank_correlation(towards.flip(3), noise).item() < -0.95
    assert abs(rank_correlation(random, noise).item()) < 0.1  # 5 standard deviations of 3072 pixels


def test_effort_noise_ignores_the_image_and_effort_error_the_halves():
    a, b, image = (torch.rand(1, 3, 16, 16, generator=generator(i)) for i in range(3))
    counts = torch.randint(0, 9, (1, 1, 16, 16), generator=generator(3))
    one, other = (Comparison.of(x, a, b, counts=counts) for x in (image, image.flip(3)))
    swapped = Comparison.of(image, b, a, counts=counts)
    assert EFFORT_NOISE.score(one) == EFFORT_NOISE.score(other)
    assert EFFORT_ERROR.score(one) == EFFORT_ERROR.score(swapped) != EFFORT_ERROR.score(other)


def test_pixels_at_the_cap_are_a_share_in_percent():
    counts = torch.tensor([[8, 8, 2, 0], [1, 1, 1, 1]]).view(2, 1, 2, 2)
    assert at_cap(counts, 8).tolist() == [50, 0]
    grey = torch.full((2, 3, 2, 2), 0.5)
    frame = Comparison.of(grey, grey, grey, counts=counts, max_samples=1)
    assert AT_CAP.score(frame).tolist() == [75, 100]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.int64])
def test_ranks_of_negative_and_far_apart_values_equal_those_of_scipy(dtype):
    values = torch.tensor([0.0, -0.0, -3e5, 7e5, -2.5, 4.0, -2.5, 1e-3], dtype=dtype)
    others = torch.tensor([3.0, 1.0, -4.0, 1.0, -5.0, 9.0, 2.0, -6.0], dtype=dtype)
    expected = spearmanr(values, others).statistic
    found = rank_correlation(values.view(1, 1, 2, 4), others.view(1, 1, 2, 4))
    assert found.item() == pytest.approx(expected, abs=1e-6)

"""Gamma-distributed means of samples: moments, gradients, and what they do without noise."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from methods.ours.policy.gamma_samples import draw_gamma_mean, redraw_as_gamma, sample_variance
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from tests.baselines.noise import exponential_noise, random_tensor

DRAWS = 400_000

# shapes k = n m^2 / v, from rare light to almost no noise
GAMMA = pytest.mark.parametrize(
    ("spp", "variance"), [(1.0, 20.0), (1.5, 4.0), (3.0, 1.0), (8.0, 0.01)]
)


def many_draws(spp: float, variance: float) -> tuple[Tensor, Tensor]:
    """Draws with expectation 0.7, and the count that they depend on."""
    one, generator = torch.ones(1, 1, 1, DRAWS), torch.Generator().manual_seed(7)
    relaxed_counts = (spp * one).requires_grad_()
    return draw_gamma_mean(0.7 * one, variance * one, relaxed_counts, generator), relaxed_counts


@GAMMA
def test_gamma_draws_have_the_mean_and_variance_of_samples(spp: float, variance: float) -> None:
    means, _ = many_draws(spp, variance)
    sample = means.detach().double()
    assert abs(sample.mean() - 0.7) < 4 * sample.std() / DRAWS**0.5
    squares = (sample - 0.7).square()
    assert abs(squares.mean() - variance / spp) < 4 * squares.std() / DRAWS**0.5


@GAMMA
def test_gamma_draws_have_the_gradient_of_their_squared_error(spp: float, variance: float) -> None:
    """E (I - m)^2 = v / n, so its derivative is -v / n^2."""
    means, relaxed_counts = many_draws(spp, variance)
    (means - 0.7).square().sum().backward()
    gradient = relaxed_counts.grad.double()
    assert abs(gradient.mean() + variance / spp**2) < 4 * gradient.std() / DRAWS**0.5


def test_gamma_draws_and_their_gradients_are_finite() -> None:
    means = torch.tensor([0.0, 1e-12, 1e-3, 1.0, 6e4]).view(1, 1, 5, 1, 1)
    variances = torch.tensor([0.0, 1e-20, 1e-3, 1.0, 1e9]).view(1, 1, 1, 5, 1)
    means, variances = (each.expand(1, 1, 5, 5, 1000).flatten(2, 3) for each in (means, variances))
    relaxed_counts = torch.full((1, 1, 25, 1000), 2.0, requires_grad=True)
    means_drawn = draw_gamma_mean(
        means, variances, relaxed_counts, torch.Generator().manual_seed(0)
    )
    (means_drawn + 0 * relaxed_counts).sum().backward()
    assert torch.isfinite(means_drawn).all()
    assert (means_drawn >= 0).all()
    assert torch.isfinite(relaxed_counts.grad).all()


@pytest.mark.parametrize(("mean", "variance"), [(0.0, 1.0), (0.7, 0.0)])
def test_without_light_or_noise_a_draw_is_the_mean(mean: float, variance: float) -> None:
    means = torch.full((1, 3, 4, 4), mean)
    spread = torch.full_like(means, variance)
    means_drawn = draw_gamma_mean(means, spread, torch.ones(1, 1, 4, 4), torch.Generator())
    assert torch.equal(means_drawn, means)


def test_the_sample_variance_is_measured_around_each_pixels_own_mean() -> None:
    """Exponential noise around m has variance m^2, although neighbours have other means."""
    mean = torch.where(torch.arange(300) % 2 < 1, 0.5, 1.5).expand(1, 1, 3, 300, 300)
    noise = exponential_noise(1, 8, 3, 300, 300)
    measured = sample_variance(mean * noise).mean()
    expected = (0.5**2 + 1.5**2) / 2
    # one variance of 8 exponential samples has a deviation of about its own size
    assert abs(measured - expected) < 4 * 2.25 / (3 * 300 * 300) ** 0.5


def test_an_infinite_sample_gives_a_finite_variance() -> None:
    radiance = random_tensor(1, 8, 3, 5, 5)
    radiance[0, 0, 0, 2, 2] = torch.inf
    assert torch.isfinite(sample_variance(radiance)).all()


def test_equal_frames_give_equal_gamma_draws() -> None:
    (frame,) = procedural_clip(0, Size(1, 24, 40), 1)
    samples, counts = frame.pool.empty(), torch.full((1, 1, 24, 40), 2.0)
    one, two = (redraw_as_gamma(samples, counts, frame).radiance for _ in range(2))
    assert torch.equal(one, two)
    assert one.std() > 0

"""DASR: its pilot, losses, training stages, and gamma-distributed samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor, nn

from baselines.dasr.method import Dasr, build
from baselines.dasr.train import (
    draw_gamma_mean,
    laplacian_of_gaussian,
    relative_loss,
    sample_variance,
    training_task,
)
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip
from tests.baselines.noise import exponential_noise, one_sample, random_tensor

CPU = torch.device("cpu")
SIZE = Size(1, 24, 40)
DENOISER_STAGE = 0.1  # fraction of a training
DRAWS = 400_000


def small_clip(frames: int = 1) -> InMemoryClip:
    return procedural_clip(0, SIZE, frames)


@pytest.fixture(scope="module")
def method() -> Dasr:
    return build("", CPU, "random")


def test_the_pilot_is_part_of_the_mean_and_of_the_budget(method: Dasr) -> None:
    (frame,) = small_clip()
    (result,) = run_clip(method, small_clip(), 2.5)
    assert torch.equal(result.samples.radiance[:, 0], frame.pool.radiance[:, 0])
    assert int(result.samples.counts.sum()) == round(2.5 * SIZE.h * SIZE.w)


def test_the_density_depends_on_the_pilot(method: Dasr) -> None:
    (frame,) = small_clip()
    pilots = [one_sample(gain * frame.pool.radiance[:, 0]) for gain in (1.0, 2.0)]
    assert not torch.equal(*(method.plan(frame.gbuffer, pilot, None) for pilot in pilots))


def test_edges_equal_scipy() -> None:
    image = random_tensor(2, 3, 20, 27).double()
    options = {"mode": "constant", "radius": 5}
    planes = [
        ndimage.gaussian_laplace(ndimage.gaussian_filter(plane, 1.5, **options), 1.5, **options)
        for plane in image.flatten(0, 1).numpy()
    ]
    expected = torch.from_numpy(np.stack(planes)).view_as(image)
    # two sums of 22 terms in double precision
    torch.testing.assert_close(laplacian_of_gaussian(image), expected, rtol=0, atol=1e-12)


def test_the_loss_is_the_relative_error_of_colour_and_of_edges() -> None:
    image, reference = random_tensor(1, 3, 24, 24), random_tensor(1, 3, 24, 24, seed=1)
    colour, edges = ((f(image) - f(reference)).abs() for f in (torch.abs, laplacian_of_gaussian))
    expected = ((colour + edges) / (reference + 0.01)).mean()
    torch.testing.assert_close(relative_loss(image, reference), expected)


def updated_networks(variant: str, fraction_done: float) -> set[str]:
    """The networks that one training step changes at this point of the training."""
    task = training_task(variant, CPU, seed=0)
    nn.init.normal_(task.networks.sampler.last.weight, 0, 0.1, torch.Generator().manual_seed(0))
    before = {name: p.clone() for name, p in task.networks.named_parameters()}
    optimizer = torch.optim.Adam(task.networks.parameters(), 1e-3)
    task.on_progress(fraction_done)
    (loss,) = task.losses(small_clip(), 2.5)
    loss.backward()
    optimizer.step()
    after = task.networks.named_parameters()
    return {name.partition(".")[0] for name, p in after if not torch.equal(p, before[name])}


@pytest.mark.parametrize(
    ("variant", "fraction_done", "names"),
    [
        ("", 24.9 / 70, {"denoiser"}),
        ("", 25.1 / 70, {"sampler"}),
        ("", 29.9 / 70, {"sampler"}),
        ("", 30.1 / 70, {"denoiser", "sampler"}),
        ("gamma", 0.0, {"denoiser"}),
        ("gamma", 0.4, {"sampler"}),
        ("gamma", 0.999, {"denoiser", "sampler"}),
    ],
)
def test_a_stage_updates_only_its_networks(
    variant: str, fraction_done: float, names: set[str]
) -> None:
    assert updated_networks(variant, fraction_done) == names


def test_sampling_is_uniform_before_the_sampler_is_trained() -> None:
    task = training_task("", CPU, seed=0)
    (result,) = run_clip(task.method, small_clip(), 3.0)
    assert torch.equal(result.samples.counts, torch.full_like(result.samples.counts, 3))


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
    losses = []
    for _ in range(2):
        task = training_task("gamma", CPU, seed=0)
        task.on_progress(DENOISER_STAGE)
        losses.append([loss.item() for loss in task.losses(small_clip(2), 2.0)])
    assert losses[0] == losses[1]

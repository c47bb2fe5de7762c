"""DASR: sizes, its losses, its stages, and gamma-distributed samples."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor, nn

from baselines.dasr import TRAITS
from baselines.dasr.gamma import draw, gamma, variance
from baselines.dasr.losses import edges, relative
from baselines.dasr.method import Dasr, build
from baselines.dasr.network import Networks
from baselines.dasr.train import trainer
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.run import run_clip
from rlbench.training import TrainingConfig, train
from rlbench.weights import digest
from tests.conftest import write_noise

CPU = torch.device("cpu")
SIZE = Size(1, 24, 40)
VARIANTS = pytest.mark.parametrize("variant", ["", "gamma"])
DENOISER_ALONE, MAP_ALONE = 0.1, 0.4  # shares of a training


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def small_clip(frames: int = 1, size: Size = SIZE, seed: int = 0) -> InMemoryClip:
    return procedural_clip(seed, size, frames=frames)


def half_noisy(seed: int, side: int = 32) -> InMemoryClip:
    """A grey world: noise left, none right, and albedo tells them apart."""
    left = torch.arange(side).expand(1, 1, side, side) < side // 2
    truth = torch.full((1, 3, side, side), 0.5)
    noise = -drawn(1, 8, 1, side, side, seed=seed).clamp_min(1e-6).log()  # mean one
    gbuffer = GBuffer(
        {
            "albedo": torch.where(left, 0.8, 0.3).expand(1, 3, side, side),
            "normal": torch.zeros(1, 3, side, side),
            "depth": torch.ones(1, 1, side, side),
        }
    )
    pool = StoredPool(torch.where(left[:, None], noise, 1.0) * truth[:, None], (seed,))
    frame = Frame(0, gbuffer, pool, Reference(truth, truth))
    return InMemoryClip("half noisy", "half noisy", "", [frame])


@pytest.fixture(scope="module")
def method() -> Dasr:
    return build("", CPU, "random")


def counted(outputs: int) -> int:
    """Weights and biases of 3x3 convolutions, written out: sum of a * b * 9 + b."""
    down = (10, 32, 32, 43, 43, 57, 57, 76, 76, 101, 101, 101, 101)
    up = ((202, 76, 76), (152, 57, 57), (114, 43, 43), (86, 32, 32), (64, 128, 64, outputs))
    steps = [*pairwise(down), *(step for level in up for step in pairwise(level))]
    return sum(a * b * 9 + b for a, b in steps)


@pytest.mark.parametrize(("part", "outputs"), [("sampler", 1), ("denoiser", 3)])
def test_parameter_counts(part: str, outputs: int) -> None:
    count = sum(p.numel() for p in Networks().get_submodule(part).parameters())
    assert count == counted(outputs)
    assert count == pytest.approx(1.07e6, rel=1e-3)  # as published


@pytest.mark.parametrize("size", [Size(1, 32, 32), Size(2, 33, 31), Size(1, 5, 40), Size(1, 1, 1)])
def test_any_size_goes_in_and_comes_out(method: Dasr, size: Size) -> None:
    (shown,) = run_clip(method, small_clip(1, size), 2.0)
    assert shown.image.shape == (size.n, 3, size.h, size.w)
    assert torch.isfinite(shown.image).all()


def test_at_one_sample_per_pixel_all_get_one(method: Dasr) -> None:
    (shown,) = run_clip(method, small_clip(), 1.0)
    assert torch.equal(shown.samples.counts, torch.ones_like(shown.samples.counts))


def test_the_first_samples_are_part_of_the_mean_and_of_the_budget(method: Dasr) -> None:
    (frame,) = small_clip()
    (shown,) = run_clip(method, small_clip(), 2.5)
    assert torch.equal(shown.samples.radiance[:, 0], frame.pool.radiance[:, 0])
    assert int(shown.samples.counts.sum()) == round(2.5 * SIZE.h * SIZE.w)


def test_the_map_depends_on_the_first_samples(method: Dasr) -> None:
    (frame,) = small_clip()
    pilot = Samples(frame.pool.radiance[:, :1], torch.ones(1, 1, SIZE.h, SIZE.w).long())
    brighter = Samples(2 * pilot.radiance, pilot.counts)
    assert not torch.equal(
        method.plan(frame.gbuffer, pilot, None), method.plan(frame.gbuffer, brighter, None)
    )


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -1.0])
def test_a_bad_sample_leaves_the_image_finite(method: Dasr, bad: float) -> None:
    (frame,) = small_clip()
    radiance = frame.pool.radiance.clone()
    radiance[..., 3, 3] = bad
    samples = Samples(radiance, torch.full((1, 1, SIZE.h, SIZE.w), 8))
    image, _ = method.denoise(frame.gbuffer, samples, None)
    assert torch.isfinite(image).all()
    assert (image >= 0).all()


def test_half_precision_gives_the_same_image_but_for_rounding(method: Dasr) -> None:
    (frame,) = small_clip()
    samples = Samples(frame.pool.radiance, torch.full((1, 1, SIZE.h, SIZE.w), 8))
    image, _ = method.denoise(frame.gbuffer, samples, None)
    with torch.autocast("cpu", torch.bfloat16):
        half, _ = method.denoise(frame.gbuffer, samples, None)
    assert half.dtype == torch.float32
    # bfloat16 has 8 bits, and what is said is of order one tenth, through 23 layers
    torch.testing.assert_close(half, image, rtol=0, atol=1e-2)


def test_edges_are_those_of_scipy() -> None:
    image = drawn(2, 3, 20, 27).double()
    alone = {"mode": "constant", "radius": 5}
    each = [
        ndimage.gaussian_laplace(ndimage.gaussian_filter(plane, 1.5, **alone), 1.5, **alone)
        for plane in image.flatten(0, 1).numpy()
    ]
    expected = torch.from_numpy(np.stack(each)).view_as(image)
    # two sums of 22 terms in double precision
    torch.testing.assert_close(edges(image), expected, rtol=0, atol=1e-12)


def test_the_loss_is_relative_to_the_reference() -> None:
    """The same error of colour and of edges counts twice as much where all is half as bright."""
    dark, error = torch.full((1, 3, 24, 24), 0.99), 0.1 * drawn(1, 3, 24, 24)
    bright = torch.full((1, 3, 24, 24), 1.99)
    # both references are 0.01 short of 1 and 2; float32 sums of 1728
    torch.testing.assert_close(
        relative(dark + error, dark), 2 * relative(bright + error, bright), rtol=1e-4, atol=0
    )


def test_the_loss_is_zero_where_equal() -> None:
    image = drawn(1, 3, 24, 24)
    assert float(relative(image, image)) == 0


def test_stripes_cost_more_than_a_shift_of_brightness_of_equal_size() -> None:
    """What the term of edges is for."""
    reference = (torch.arange(64) % 16 < 8).float().expand(1, 3, 64, 64) + 1
    fine = 0.1 * ((torch.arange(64) % 8 < 4).float() * 2 - 1)
    shift = torch.full((64,), 0.1)
    assert relative(reference + fine, reference) > 1.05 * relative(reference + shift, reference)


def moved(variant: str, done: float) -> set[str]:
    """The networks that one step changes at this point of a training."""
    made = trainer(variant, CPU, seed=0)
    nn.init.normal_(made.networks.sampler.last.weight, 0, 0.1, torch.Generator().manual_seed(0))
    before = {name: [p.clone() for p in net.parameters()] for name, net in _children(made)}
    optimizer = torch.optim.Adam(made.networks.parameters(), 1e-3)
    made.on_progress(done)
    (loss,) = made.losses(small_clip(), 2.5)
    loss.backward()
    optimizer.step()
    return {
        name
        for name, net in _children(made)
        if any(not torch.equal(p, q) for p, q in zip(net.parameters(), before[name], strict=True))
    }


def _children(made) -> list[tuple[str, nn.Module]]:
    return list(made.networks.named_children())


@VARIANTS
@pytest.mark.parametrize(
    ("done", "names"),
    [
        (0.0, {"denoiser"}),
        (24.9 / 70, {"denoiser"}),
        (25.1 / 70, {"sampler"}),
        (29.9 / 70, {"sampler"}),
        (30.1 / 70, {"denoiser", "sampler"}),
        (0.999, {"denoiser", "sampler"}),
    ],
)
def test_a_stage_moves_its_networks_alone(variant: str, done: float, names: set[str]) -> None:
    assert moved(variant, done) == names


def test_until_the_map_is_trained_sampling_is_uniform() -> None:
    made = trainer("", CPU, seed=0)
    (shown,) = run_clip(made.method, small_clip(), 3.0)
    assert torch.equal(shown.samples.counts, torch.full_like(shown.samples.counts, 3))


class KilledError(Exception):
    """What a kill is to a test."""


def test_a_training_killed_in_one_stage_goes_on_in_it(tmp_path: Path) -> None:
    clip = write_noise(tmp_path / "clips" / "noise", frames=1, h=32, w=32)
    plan = TrainingConfig(frames=12, crop=16, eval_interval=4)  # stages of 5 frames, 1, and 6

    def run(out: Path, kill_after: int | None = None) -> str:
        def report(progress, loss) -> None:
            if progress.sequences == kill_after:
                raise KilledError

        train("dasr", [clip], [clip], out, plan, on_progress=report)
        return digest(out / "dasr.safetensors")

    with pytest.raises(KilledError):
        run(tmp_path / "killed", kill_after=5)  # one draw after the first checkpoint
    assert run(tmp_path / "killed") == run(tmp_path / "undisturbed")


class Averaging(nn.Module):
    """A denoiser that says the colour it sees."""

    def forward(self, seen: Tensor) -> Tensor:
        return seen[:, :3]


@VARIANTS
def test_the_map_learns_where_noise_is(variant: str) -> None:
    made = trainer(variant, CPU, seed=0)
    made.networks.denoiser = Averaging()
    optimizer = torch.optim.Adam(made.networks.sampler.parameters(), 1e-3)
    made.on_progress(MAP_ALONE)
    for seed in range(12):
        for loss in made.losses(half_noisy(seed), 3.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    (shown,) = run_clip(made.method, half_noisy(99), 3.0)
    left, right = shown.samples.counts.float().mean((0, 1, 2)).view(2, 16).mean(1).tolist()
    assert left > 2 * right  # 3 and 3 before, 5 and 1 at best


# shapes k = n m^2 / v from rare light to nearly none of its noise
GAMMA = pytest.mark.parametrize(
    ("number", "of_variance"), [(1.0, 20.0), (1.5, 4.0), (3.0, 1.0), (8.0, 0.01)]
)


def several(number: float, of_variance: float) -> tuple[Tensor, Tensor, int]:
    """400,000 draws of mean 0.7, and the number that they were drawn for."""
    count = 400_000
    due = torch.full((1, 1, 1, count), number, requires_grad=True)
    mean, spread = torch.full((1, 1, 1, count), 0.7), torch.full((1, 1, 1, count), of_variance)
    return draw(mean, spread, due, torch.Generator().manual_seed(7)), due, count


@GAMMA
def test_gamma_draws_have_the_mean_and_variance_of_samples(
    number: float, of_variance: float
) -> None:
    drawn_means, _, count = several(number, of_variance)
    sample = drawn_means.detach().double()
    assert abs(sample.mean() - 0.7) < 4 * sample.std() / count**0.5
    squares = (sample - 0.7).square()
    assert abs(squares.mean() - of_variance / number) < 4 * squares.std() / count**0.5


@GAMMA
def test_gamma_draws_have_the_slope_of_their_squared_error(
    number: float, of_variance: float
) -> None:
    """E (I - m)^2 = v / n, so its slope is -v / n^2."""
    drawn_means, due, count = several(number, of_variance)
    (drawn_means - 0.7).square().sum().backward()
    slope = due.grad.double()
    assert abs(slope.mean() + of_variance / number**2) < 4 * slope.std() / count**0.5


@pytest.mark.parametrize("mean", [0.0, 1e-12, 1e-3, 1.0, 6e4])
@pytest.mark.parametrize("of_variance", [0.0, 1e-20, 1e-3, 1.0, 1e9])
def test_gamma_draws_are_finite_and_so_are_their_slopes(mean: float, of_variance: float) -> None:
    due = torch.full((1, 1, 1, 1000), 2.0, requires_grad=True)
    means = torch.full((1, 1, 1, 1000), mean)
    found = draw(means, torch.full_like(means, of_variance), due, torch.Generator().manual_seed(0))
    (found + 0 * due).sum().backward()
    assert torch.isfinite(found).all()
    assert (found >= 0).all()
    assert torch.isfinite(due.grad).all()


@pytest.mark.parametrize(("mean", "of_variance"), [(0.0, 1.0), (0.7, 0.0)])
def test_without_light_or_without_noise_a_draw_is_the_mean(mean: float, of_variance: float) -> None:
    means = torch.full((1, 3, 4, 4), mean)
    spread = torch.full_like(means, of_variance)
    found = draw(means, spread, torch.ones(1, 1, 4, 4), torch.Generator())
    assert torch.equal(found, means)


def test_the_variance_is_that_of_samples_around_each_pixels_own_mean() -> None:
    """Of exponential noise around m it is m^2, though neighbours have other means."""
    mean = torch.where(torch.arange(300) % 2 < 1, 0.5, 1.5).expand(1, 1, 3, 300, 300)
    noise = -drawn(1, 8, 3, 300, 300).clamp_min(1e-6).log()
    found = variance(mean * noise).mean()
    expected = (0.5**2 + 1.5**2) / 2
    # one variance of 8 exponential samples has a deviation of about its own size
    assert abs(found - expected) < 4 * 2.25 / (3 * 300 * 300) ** 0.5


def test_a_bad_sample_has_no_variance() -> None:
    radiance = drawn(1, 8, 3, 5, 5)
    radiance[0, 0, 0, 2, 2] = torch.inf
    assert torch.isfinite(variance(radiance)).all()


def test_gamma_gives_the_method_a_mean_and_nothing_of_the_pool() -> None:
    (frame,) = small_clip()
    samples = Samples(frame.pool.radiance, torch.full((1, 1, SIZE.h, SIZE.w), 8))
    taught = gamma(samples, torch.full((1, 1, SIZE.h, SIZE.w), 2.0), frame)
    assert taught.radiance.shape == (1, 1, 3, SIZE.h, SIZE.w)
    assert torch.equal(taught.mean, taught.radiance[:, 0])


def test_gamma_draws_are_the_same_for_the_same_frame() -> None:
    losses = []
    for _ in range(2):
        made = trainer("gamma", CPU, seed=0)
        made.on_progress(DENOISER_ALONE)
        losses.append([loss.item() for loss in made.losses(small_clip(2), 2.0)])
    assert losses[0] == losses[1]


def test_the_traits_are_those_of_a_pilot_of_one_sample() -> None:
    assert (TRAITS.pilot_spp, TRAITS.min_samples, TRAITS.temporal, TRAITS.discard_pilot) == (
        1.0,
        1,
        False,
        False,
    )

"""The gradient through stochastic rounding, against exact gradients in closed form."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from methods.ours.gradients.estimators import ESTIMATORS, Estimator
from methods.ours.gradients.toy_problem import (
    Direct,
    Filter,
    FixedFilter,
    Mode,
    ToyProblem,
    toy_frames,
)
from methods.ours.policy import (
    AllocationProblem,
    SamplerLearner,
    StochasticLearner,
)

SIDE = 15
FULL_LATTICE = 25  # pairs, one for each offset of cells of 5x5 pixels


def make_generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def fixed_action(n: int = 1) -> Tensor:
    """An action that differs from pixel to pixel; each image has a leaf of its own."""
    action = torch.rand(1, 1, SIDE, SIDE, generator=make_generator(2)) - 0.5
    return (action - action.mean()).repeat(n, 1, 1, 1).requires_grad_()


@dataclass(frozen=True)
class ExpectedProblem(ToyProblem):
    """Errors are expectations over samples, so that only rounding and switching are random."""

    def evaluate_counts(self, counts: Tensor) -> Tensor:
        return torch.stack([self.expected_error(each.float()) for each in counts])


@dataclass(frozen=True)
class RecordingProblem(ToyProblem):
    """Keeps the counts that are evaluated."""

    evaluated: list[Tensor] = field(default_factory=list)

    def evaluate_counts(self, counts: Tensor) -> Tensor:
        self.evaluated.append(counts)
        return super().evaluate_counts(counts)


def make_problem(
    kind: Callable[..., ToyProblem], mode: Mode, spp: float, n: int = 1, **settings: int
) -> tuple[ToyProblem, Tensor]:
    """The same scene n times, with samples of its own in each, and the action."""
    scene, action = next(toy_frames(3, 1, SIDE)), fixed_action(n)
    names = ("observation", "truth", "sigma", "prior")
    many = replace(scene, **{name: getattr(scene, name).expand(n, -1, -1, -1) for name in names})
    frame = many.resample(make_generator(1))
    return kind(frame, mode, lambda observation: action, spp, **settings), action


def gradients(learner: SamplerLearner, problem: AllocationProblem, action: Tensor) -> Tensor:
    """[n 1 h w] The gradient of each image."""
    (gradient,) = torch.autograd.grad(learner.loss(problem, make_generator()), action)
    return gradient * len(action)


def closed_form(problem: ToyProblem, action: Tensor) -> Tensor:
    """The exact gradient of the first image's mean error, where every pixel is judged alone.

    The slope of a pixel between m and m + 1 samples is e(m + 1) - e(m); the budget is shared.
    """
    action, sigma = action[:1].detach().double(), problem.frame.sigma[:1].double()
    density = (1 + action) / 2
    shares = problem.spp * density / density.mean()
    assert shares.max() < problem.max_samples  # no pixel is at a bound
    m = shares.floor()
    slope = sigma.square() / (m + 1.5) - sigma.square() / (m + 0.5)
    centred = slope - (slope * density).sum() / density.sum()
    return centred * (problem.spp / density.mean()) / 2 / density.numel()


def squared_z_score(learner: SamplerLearner, spp: float, draws: int = 256) -> float:
    """Mean over pixels of ((mean - exact) / standard error)^2: 1 without a bias."""
    problem, action = make_problem(ToyProblem, Direct(), spp, draws)
    toy, shape = problem.frame, problem.frame.stored.shape
    noise = toy.sigma.unsqueeze(1) * torch.randn(shape, generator=make_generator(5))
    problem = replace(problem, frame=replace(toy, stored=toy.truth.unsqueeze(1) + noise))
    drawn = gradients(learner, problem, action).double()
    standard_error = drawn.std(0) / draws**0.5
    deviation = (drawn.mean(0) - closed_form(problem, action)[0]) / standard_error
    return float(deviation.square().mean())


SINGLE = StochasticLearner(block=1, margin=0, is_standardized=False)
TOLERANCE = 0.5  # of a mean of 225 squared normal values: 5 standard deviations


@pytest.mark.parametrize("spp", [0.25, 0.6, 1.5, 2.5])  # counts in [0.1, 4)
def test_the_gradient_of_expected_errors_is_that_in_closed_form(spp):
    """Planned counts are below 1 in all pixels, in some, and in none; nothing is left to chance."""
    problem, action = make_problem(ExpectedProblem, Direct(), spp)
    exact = closed_form(problem, action).float()
    torch.testing.assert_close(gradients(SINGLE, problem, action), exact, rtol=1e-3, atol=1e-8)


@pytest.mark.parametrize("spp", [0.25, 2.5])
def test_the_mean_gradient_of_realised_errors_is_that_in_closed_form(spp):
    """Samples are normal here: log-normal ones have tails that no mean of draws settles."""
    assert squared_z_score(SINGLE, spp) == pytest.approx(1, abs=TOLERANCE)


def test_a_pixel_without_samples_has_a_gradient_of_its_own():
    """Where the surrogate has none but the change of the common price."""
    problem, action = make_problem(ExpectedProblem, Direct(), 0.25)
    empty = problem.draw_counts(action) == 0
    gradient = gradients(replace(SINGLE, pairs=1), problem, action)
    exact = closed_form(problem, action).float()
    assert empty.float().mean() > 0.7
    torch.testing.assert_close(gradient[empty], exact[empty], rtol=1e-3, atol=1e-8)


def flipped_gradient(problem: ToyProblem, action: Tensor) -> Tensor:
    """The gradient by brute force: each pixel alone is set to m and to m + 1."""
    counts = problem.relaxed_counts(action)
    drawn, lower = problem.draw_counts(action), counts.detach().floor().long()
    gain = torch.zeros_like(counts)
    for row, column in itertools.product(range(SIDE), range(SIDE)):
        at = (..., row, column)
        pair = torch.stack((drawn, drawn))
        pair[0][at], pair[1][at] = lower[at] + 1, lower[at]
        errors = problem.evaluate_counts(pair).sum((1, 2, 3, 4))
        gain[at] = errors[0] - errors[1]
    (gradient,) = torch.autograd.grad((gain * counts).mean(), action)
    return gradient


@pytest.mark.parametrize("mode", [Filter(), FixedFilter()], ids=["count-weighted", "fixed"])
@pytest.mark.parametrize("spp", [0.5, 2.3])
@pytest.mark.parametrize("kind", [ToyProblem, ExpectedProblem])
def test_all_offsets_together_switch_every_pixel_alone(mode, spp, kind):
    """Effects do not overlap: the same errors as from one pair of images for each pixel."""
    problem, action = make_problem(kind, mode, spp)
    learner = StochasticLearner(block=1, margin=2, pairs=FULL_LATTICE, is_standardized=False)
    expected = flipped_gradient(problem, action)
    found = gradients(learner, problem, action)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=2e-3 * float(expected.abs().max()))


@pytest.mark.parametrize("spp", [0, 0.25, 3.0, 7.9])
@pytest.mark.parametrize("block", [1, 4])
def test_evaluated_counts_stay_within_the_stored_samples(spp, block):
    problem, action = make_problem(RecordingProblem, Direct(), spp)
    learner = StochasticLearner(block=block, margin=1, pairs=3)
    assert torch.isfinite(gradients(learner, problem, action)).all()
    (counts,) = problem.evaluated
    assert len(counts) == 2 * learner.pairs
    assert counts.min() >= 0
    assert counts.max() <= problem.max_samples


def test_pixels_must_keep_the_minimum_of_samples():
    problem, action = make_problem(RecordingProblem, Direct(), 1.2, min_samples=1)
    gradients(replace(SINGLE, stride=0.9), problem, action)
    assert min(int(counts.min()) for counts in problem.evaluated) == 1


def test_pixels_outside_the_blocks_keep_their_counts():
    problem, action = make_problem(RecordingProblem, Direct(), 0.5)
    learner = StochasticLearner(block=2, margin=2, pairs=1)
    learner.loss(problem, make_generator())
    (counts,) = problem.evaluated
    drawn = problem.draw_counts(action)
    differs = (counts[0] != counts[1])[0, 0]
    assert torch.equal(counts[0][0, 0][~differs], drawn[0, 0][~differs])
    assert 2 * 2 / 6**2 / 2 < differs.float().mean() < 2 * 2 * 2 / 6**2  # one block in each cell


@pytest.mark.parametrize(("block", "margin"), [(1, 0), (1, 2), (4, 2)])
def test_every_pixel_is_switched_equally_often(block, margin):
    learner = StochasticLearner(block=block, margin=margin, pairs=(block + 2 * margin) ** 2)
    blocks = learner.draw_blocks(torch.zeros(2, 1, 9, 17), make_generator())
    assert torch.equal(blocks.is_block.sum(0), torch.full((2, 1, 9, 17), block**2))


def test_signs_are_shared_within_a_cell_and_differ_between_cells():
    blocks = StochasticLearner().draw_blocks(torch.zeros(1, 1, 64, 64), make_generator())
    for pair in range(2):
        cell, sign = blocks.cell[pair].flatten(), blocks.sign[pair].flatten()
        assert all(sign[cell == number].unique().numel() == 1 for number in cell.unique())
        assert sign.unique().tolist() == [-1, 1]


def test_a_price_removes_noise():
    """The mean gradient is the same; the budget would subtract the price with more noise."""
    problem, action = make_problem(ExpectedProblem, Direct(), 0.5, 64)
    learner = StochasticLearner(block=1, margin=2, is_standardized=False)
    with_price = gradients(learner, problem, action)
    without = gradients(replace(learner, price_weight=0.0), problem, action)
    assert with_price.var(0).sum() < 0.9 * without.var(0).sum()


def noise(denoiser: Mode, spp: float, **settings: float) -> float:
    """Variance of one gradient of the tile parameters."""
    learner = replace(ESTIMATORS["stochastic"].make_learner(denoiser), **settings)
    return float(Estimator(lambda mode: learner).draw(denoiser, spp, 96).var(0).sum())


@pytest.mark.parametrize("spp", [0.5, 4])
def test_blocks_remove_noise(spp):
    assert noise(Filter(), spp) < 0.5 * noise(Filter(), spp, block=1)


def test_a_stride_removes_noise_at_many_samples():
    assert noise(Direct(), 16.0) < 0.3 * noise(Direct(), 16.0, stride=0.0)


def test_standardized_gradients_do_not_depend_on_the_unit_of_radiance():
    problem, action = make_problem(ToyProblem, Direct(), 0.5)
    toy = problem.frame
    scaled = {name: 10 * getattr(toy, name) for name in ("truth", "sigma", "prior", "stored")}
    brighter = replace(problem, frame=replace(toy, **scaled))
    learner = StochasticLearner(block=1, margin=0)
    torch.testing.assert_close(
        gradients(learner, brighter, action), gradients(learner, problem, action)
    )


def test_outliers_are_clipped():
    """One pixel whose next sample is a firefly gets three times the mean of the others."""
    problem, action = make_problem(ToyProblem, Direct(), 0.5)
    stored = problem.frame.stored.clone()
    stored[..., 7, 7] = 1e3
    bright = replace(problem, frame=replace(problem.frame, stored=stored))
    learner = StochasticLearner(block=1, margin=0)
    free, clipped = (
        gradients(replace(learner, clip=clip), bright, action)[0, 0] for clip in (1e9, 3.0)
    )
    assert free[7, 7] > 50 * free.abs().median()
    assert 0 < clipped[7, 7] < 0.1 * free[7, 7]


def test_a_budget_of_zero_has_no_gradient():
    problem, action = make_problem(ToyProblem, Filter(), 0)
    assert not gradients(StochasticLearner(), problem, action).any()

"""The exact expected error of an action, and its exact gradient, through whole sample counts.

Shares of the budget are rounded to whole counts by systematic sampling with one random offset. As
the offset passes from 0 to 1, the counts change once per pixel: these outcomes and their
probabilities are listed, and the expected error of each is known in closed form. The probabilities
are differentiable in the shares, hence so is their sum.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.experiments.gradients.problem import tile_parameters
from methods.ours.experiments.gradients.systematic import hilbert_order, round_systematically
from methods.ours.experiments.known_optimum import ToyProblem, toy_density
from rlbench.training.surrogate_gradient import relaxed_counts

__all__ = ["RoundingOutcomes", "expected_error", "list_outcomes", "relaxed_error", "true_gradient"]


class RoundingOutcomes(NamedTuple):
    """All counts that one image's shares can be rounded to."""

    counts: Float[Tensor, "k 1 h w"]
    probabilities: Float[Tensor, " k"]  # differentiable in the shares
    offsets: Float[Tensor, " k"]  # in [0, 1]; the middle of those that lead to the counts


def list_outcomes(shares: Float[Tensor, "1 h w"]) -> RoundingOutcomes:
    """The outcomes of `SystematicProblem.draw_counts` for shares (float64) with a whole sum.

    Cumulative sums of the fractional parts, in the order of the Hilbert curve, are the marks at
    which an offset decides whether a pixel is rounded up.

    >>> outcomes = list_outcomes(torch.tensor([[[0.25, 1.75]]], dtype=torch.float64))
    >>> outcomes.counts.flatten(1).tolist(), outcomes.probabilities.tolist()
    ([[0.0, 2.0], [1.0, 1.0]], [0.75, 0.25])
    """
    order = hilbert_order(*shares.shape[-2:])
    ends = (shares - shares.detach().floor()).flatten()[order].cumsum(0)
    thresholds = 1 - (ends[:-1] - ends[:-1].detach().floor())  # the last end is whole
    edges = torch.cat((ends.new_zeros(1), thresholds.sort().values, ends.new_ones(1)))
    probabilities = edges.diff()
    offsets = ((edges[1:] + edges[:-1]) / 2).detach()
    return RoundingOutcomes(round_systematically(shares.detach(), offsets), probabilities, offsets)


def expected_error(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"], image: int = 0
) -> Float[Tensor, ""]:
    """Expected mean squared error of one image's action, over samples, prior and rounding."""
    shares = _shares(problem, action)[image]
    outcomes = list_outcomes(shares)
    errors = _errors(problem, outcomes.counts, image).mean((1, 2, 3))
    return (outcomes.probabilities * errors).sum()


def relaxed_error(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"], image: int = 0
) -> Float[Tensor, ""]:
    """The error as if counts were real numbers: rounding adds to it, most at low budgets."""
    return _errors(problem, _shares(problem, action)[image, None], image).mean()


def true_gradient(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"] | None = None, image: int = 0
) -> Float[Tensor, " p"]:
    """The gradient of `expected_error` with respect to the sampler's parameters of one image.

    `action` is the one at which the gradient is taken; None is the sampler's.
    """
    mean = problem.act()
    at = mean if action is None else action + mean - mean.detach()  # with the gradient of the mean
    (gradient,) = torch.autograd.grad(
        expected_error(problem, at, image), [tile_parameters(problem)]
    )
    return gradient[image].flatten()


def _shares(problem: ToyProblem, action: Tensor) -> Tensor:
    low = torch.full(action.shape, problem.min_samples)
    density = toy_density(action.double())
    return relaxed_counts(density, problem.spp, low, problem.max_samples)


def _errors(problem: ToyProblem, counts: Tensor, image: int) -> Tensor:
    sigma, truth = problem.frame.sigma[image, None], problem.frame.truth[image, None]
    return problem.mode.expected_error(sigma.double(), truth.double(), counts)

"""Gradient estimators, measured: the suite's learners, and two textbook ones beside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.experiments.compare_learners import blocks_of_reach, reinforce
from methods.ours.experiments.gradients.exact_gradient import (
    DENOISERS,
    make_problem,
    relaxed_error,
    tile_parameters,
    true_gradient,
)
from methods.ours.experiments.gradients.statistics import GradientStatistics
from methods.ours.experiments.toy_problem import Mode, ToyProblem
from methods.ours.policy import (
    AllocationProblem,
    BlockPolicyGradient,
    CombinedLearner,
    SamplerLearner,
    StochasticLearner,
    SurrogateLearner,
    gamma_gradient_per_sample,
)
from methods.ours.policy.sample_gradients import kuznetsov_gradient_per_sample
from rlbench.training.surrogate_gradient import SampleGradient, kuznetsov_gradient

__all__ = ["ESTIMATORS", "Estimator", "Measurement", "ScoreFunction", "measure"]

BATCH = 32  # images of one backward pass
SMALLER_BLOCKS = "use smaller blocks, at the price of more noise"
LOCAL = BlockPolicyGradient(block=1, margin=0)  # an action per pixel


@dataclass(frozen=True)
class ScoreFunction:
    """The textbook estimator (Williams 1992): one reward for the image, credited to every pixel.

    Unbiased for the expected error of the noisy action. `baseline` subtracts the mean error of the
    other draws from the same frame and samples.
    """

    baseline: bool
    policy: BlockPolicyGradient = LOCAL
    min_samples: int = 0
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """Mean over draws of error times log-probability of the action."""
        mean, draws = problem.act(), self.policy.draws
        actions = torch.stack([self.policy.explore(mean, (0, 0), generator) for _ in range(draws)])
        errors = problem.rollout(actions).errors.mean((2, 3, 4))  # k n
        if self.baseline:
            errors = (errors - errors.mean(0)) * draws / (draws - 1)  # minus mean of the others
        distance = (actions - mean) / self.policy.action_std
        log_probability = -distance.square().sum((2, 3, 4)) / 2
        loss: Tensor = (errors * log_probability).mean()
        return loss


@dataclass(frozen=True)
class RelaxedTruth:
    """The gradient of the expected error as if counts were real numbers; without noise."""

    min_samples: int = 0
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The relaxed error, mean over images."""
        assert isinstance(problem, ToyProblem)
        action = problem.act()
        return torch.stack([relaxed_error(problem, action, i) for i in range(len(action))]).mean()


@dataclass(frozen=True)
class ExploredTruth:
    """The exact gradient at noisy actions: what a policy of this noise can learn at best."""

    policy: BlockPolicyGradient = LOCAL
    min_samples: int = 0
    network: None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """A loss whose gradient is the exact one at an action around the mean."""
        assert isinstance(problem, ToyProblem)
        action = self.policy.explore(problem.act(), (0, 0), generator)
        parameters = tile_parameters(problem)
        n = len(action)
        gradients = torch.stack([true_gradient(problem, action, image) for image in range(n)])
        loss: Tensor = (parameters.flatten(1) * gradients.to(parameters)).sum() / n
        return loss


@dataclass(frozen=True)
class Estimator:
    """How to make a learner for a denoiser, and what its gradient claims to be."""

    make_learner: Callable[[Mode], SamplerLearner]
    has_scale: bool = True  # False where advantages are in standard deviations
    min_spp: float = 0  # least budget at which the suite trains with it
    trains_ours: bool = True  # False for references, ablations and textbook estimators
    noise_factor: int = 1  # how many times more draws than others it needs
    remedy: str = ""  # against a wrong direction

    def draw(self, denoiser: Mode, spp: float, draws: int, seed: int = 0) -> Float[Tensor, "d p"]:
        """Independent gradients of one image each, by the learner's own loss.

        Scene and action are always the same; samples, prior, rounding and exploration are new.
        """
        learner, generator = self.make_learner(denoiser), torch.Generator().manual_seed(seed)
        rows = []
        for _ in range(0, draws, BATCH):
            problem = make_problem(denoiser, spp, BATCH, generator)
            (gradient,) = torch.autograd.grad(
                learner.loss(problem, generator), [tile_parameters(problem)]
            )
            rows.append(BATCH * gradient.flatten(1).double())  # the loss is a mean over images
        return torch.cat(rows)[:draws]


def stochastic(denoiser: Mode, block: int | None = None) -> StochasticLearner:
    """Differences over the next sample at their own length, with the blocks of `reinforce`."""
    side = block or blocks_of_reach(denoiser)
    return StochasticLearner(side, denoiser.reach, is_standardized=False)


def _not_for_training(
    make_learner: Callable[[Mode], SamplerLearner], has_scale: bool = True
) -> Estimator:
    return Estimator(make_learner, has_scale, trains_ours=False)


def _by_samples(sample_gradient: SampleGradient) -> Estimator:
    remedy = "the denoiser reads counts, which this gradient holds constant: train with reinforce"
    return Estimator(lambda denoiser: SurrogateLearner(sample_gradient), min_spp=1, remedy=remedy)


def _by_trial(make_learner: Callable[[Mode], SamplerLearner]) -> Estimator:
    remedy = f"explore with a smaller action_std; {SMALLER_BLOCKS}"
    return Estimator(make_learner, has_scale=False, noise_factor=3, remedy=remedy)


ESTIMATORS: Mapping[str, Estimator] = {
    "relaxed truth": _not_for_training(lambda denoiser: RelaxedTruth()),
    "explored truth": _not_for_training(lambda denoiser: ExploredTruth()),
    "surrogate": _by_samples(kuznetsov_gradient),
    "surrogate per sample": _by_samples(kuznetsov_gradient_per_sample),
    "gamma": _by_samples(gamma_gradient_per_sample),
    "reinforce": _by_trial(reinforce),
    "reinforce+surrogate": _by_trial(lambda denoiser: CombinedLearner(reinforce(denoiser))),
    "stochastic": Estimator(stochastic, noise_factor=3, remedy=SMALLER_BLOCKS),
    "stochastic, single pixels": _not_for_training(lambda d: stochastic(d, block=1)),
    "reinforce, no price": _not_for_training(lambda d: reinforce(d, 0.0), has_scale=False),
    "score function": _not_for_training(lambda denoiser: ScoreFunction(baseline=True)),
    "score function, no baseline": _not_for_training(lambda d: ScoreFunction(baseline=False)),
}


@dataclass(frozen=True)
class Measurement:
    """Statistics of an estimator at one budget."""

    estimator: str
    denoiser: str  # one of DENOISERS
    spp: float
    draws: int
    statistics: GradientStatistics


def measure(
    name: str, denoiser: str, spp: float, draws: int, estimator: Estimator | None = None
) -> Measurement:
    """Draw gradients and compare them with the truth; `estimator` is by default that of `name`."""
    mode = DENOISERS[denoiser]
    drawn = (estimator or ESTIMATORS[name]).draw(mode, spp, draws)
    truth = true_gradient(make_problem(mode, spp, 1, torch.Generator().manual_seed(0)))
    return Measurement(name, denoiser, spp, draws, GradientStatistics.of_draws(drawn, truth))

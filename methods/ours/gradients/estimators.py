"""Gradient estimators, measured: the suite's learners, and two textbook ones beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.gradients.compare_learners import blocks_of_reach, reinforce
from methods.ours.gradients.exact_gradient import (
    DENOISERS,
    make_problem,
    relaxed_error,
    tile_parameters,
    true_gradient,
)
from methods.ours.gradients.toy_problem import Mode, ToyProblem
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

BATCH = 32  # images of one backward pass
SMALLER_BLOCKS = "use smaller blocks, at the price of more noise"
Z95 = 1.96  # standard errors of a 95 % interval
MIN_SIGNAL_SHARE = 0.5  # of the squared mean gradient; below it the mean is mostly noise
MAX_COSINE_MARGIN = 0.15  # half width of an interval that still says something
LOCAL = BlockPolicyGradient(block=1, margin=0)  # an action per pixel


@dataclass(frozen=True)
class ScoreFunction(SamplerLearner):
    """The textbook estimator (Williams 1992): one reward for the image, credited to every pixel.

    Unbiased for the expected error of the noisy action. `baseline` subtracts the mean error of the
    other draws from the same frame and samples.
    """

    baseline: bool
    policy: BlockPolicyGradient = LOCAL

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


class RelaxedTruth(SamplerLearner):
    """The gradient of the expected error as if counts were real numbers; without noise."""

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The relaxed error, mean over images."""
        assert isinstance(problem, ToyProblem)
        action = problem.act()
        return torch.stack([relaxed_error(problem, action, i) for i in range(len(action))]).mean()


@dataclass(frozen=True)
class ExploredTruth(SamplerLearner):
    """The exact gradient at noisy actions: what a policy of this noise can learn at best."""

    policy: BlockPolicyGradient = LOCAL

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
class Interval:
    """An estimate and half the width of its 95 % confidence interval."""

    value: float
    margin: float

    def __str__(self) -> str:
        """`value ± margin`, two digits behind the point."""
        return f"{self.value:.2f} ± {self.margin:.2f}"


@dataclass(frozen=True)
class GradientStatistics:
    """What independent draws say about their expectation; the noise of the mean is removed.

    A common factor on all gradients changes `scale` and `bias` alone, and Adam divides it out. The
    cosine is the share of the steepest descent that a step of the same length along the expectation
    achieves.
    """

    scale: Interval  # component of the expectation along the truth, as a multiple of it; ideal 1
    cosine: Interval  # of expectation and truth; ideal 1; nan where noise hides the expectation
    bias: Interval  # |expectation - truth| / |truth|; ideal 0
    noise: float  # standard deviation of one draw / |component along the truth|
    is_resolved: bool  # is the direction of the expectation known, or hidden by noise?

    @property
    def frames_needed(self) -> float:
        """Draws whose mean has as much noise as signal: the square of `noise`."""
        return self.noise**2

    @classmethod
    def of_draws(
        cls, draws: Float[Tensor, "d p"], truth: Float[Tensor, " p"]
    ) -> GradientStatistics:
        """Statistics of at least two draws; intervals by the jackknife."""
        size = truth.norm()
        units = draws.double() / size  # the truth has length 1
        moments = _Moments.of(units, units @ (truth.double() / size))
        scale, squared = float(moments.along), float(moments.squared)
        noise, cosine = math.sqrt(float(units.var(0).sum())), _jackknife(moments, _cosine)
        has_signal = squared > MIN_SIGNAL_SHARE * float(units.mean(0).square().sum())
        return cls(
            scale=_jackknife(moments, lambda m: m.along),
            cosine=Interval(min(max(cosine.value, -1.0), 1.0), cosine.margin),  # nan stays
            bias=_jackknife(moments, _bias),
            noise=noise / abs(scale) if scale else math.inf,
            is_resolved=has_signal and cosine.margin <= MAX_COSINE_MARGIN,
        )


@dataclass(frozen=True)
class _Moments:
    """Component along the truth and squared length of the expectation, both unbiased."""

    along: Tensor
    squared: Tensor
    without_one: tuple[Tensor, Tensor]  # the same [d], with one of the draws left out

    @classmethod
    def of(cls, units: Tensor, along: Tensor) -> _Moments:
        count, total = len(units), units.sum(0)
        lengths = units.square().sum(1)
        # sum over pairs i != j of g_i * g_j is unbiased for the squared length of the expectation
        pairs = total.square().sum() - lengths.sum()
        pairs_without = pairs - 2 * (units @ total - lengths)
        return cls(
            along.mean(),
            pairs / (count * (count - 1)),
            (
                (along.sum() - along) / (count - 1),
                pairs_without / ((count - 1) * max(count - 2, 1)),
            ),
        )


def _cosine(moments: _Moments) -> Tensor:
    return moments.along / moments.squared.sqrt()  # outside [-1, 1] by noise; nan below 0


def _bias(moments: _Moments) -> Tensor:
    return (moments.squared - 2 * moments.along + 1).clamp_min(0).sqrt()


def _jackknife(moments: _Moments, statistic: Callable[[_Moments], Tensor]) -> Interval:
    along, squared = moments.without_one
    values = statistic(_Moments(along, squared, moments.without_one))
    count = len(values)
    error = math.sqrt((count - 1) * float(values.var(correction=0)))
    return Interval(float(statistic(moments)), Z95 * error)


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

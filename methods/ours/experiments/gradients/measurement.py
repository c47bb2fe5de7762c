"""One measurement: an estimator, a denoiser and a budget, compared with the exact gradient."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from methods.ours.experiments.gradients.estimators import ESTIMATORS, Estimator
from methods.ours.experiments.gradients.problem import DENOISERS, make_problem
from methods.ours.experiments.gradients.statistics import GradientStatistics
from methods.ours.experiments.gradients.truth import true_gradient

__all__ = ["Measurement", "measure"]


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

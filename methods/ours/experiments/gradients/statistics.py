"""Bias, direction and noise of an estimator against a known gradient, with intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

__all__ = ["GradientStatistics", "Interval"]

Z95 = 1.96  # standard errors of a 95 % interval
MIN_SIGNAL_SHARE = 0.5  # of the squared mean gradient; below it the mean is mostly noise
MAX_COSINE_MARGIN = 0.15  # half width of an interval that still says something


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

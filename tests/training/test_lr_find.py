"""The learning-rate range test: the rate grows geometrically, and the minimum is result."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from rlbench import registry
from rlbench.training import LrRangeResult, TrainingConfig, find_learning_rate
from rlbench.training.lr_find import LrPoint, _has_diverged, smooth_losses, suggest_lr
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


def valley(at: float) -> list[LrPoint]:
    """Losses with their minimum at the rate 10^at, one every tenth of a decade."""
    rates = [10 ** (-6 + k / 10) for k in range(51)]
    return [LrPoint(k, rate, (math.log10(rate) - at) ** 2) for k, rate in enumerate(rates)]


@pytest.mark.parametrize("at", [-4.0, -3.0, -2.0])
def test_a_tenth_of_the_rate_of_the_least_loss_is_suggested(at):
    assert suggest_lr(valley(at)) == pytest.approx(10 ** (at - 1), rel=1e-6)


def test_losses_are_smoothed_by_a_gaussian_window():
    points = valley(-3.0)
    weights = [math.exp(-(((k - 20) / 10 / 0.25) ** 2) / 2) for k in range(51)]
    total = sum(weight * point.loss for weight, point in zip(weights, points, strict=True))
    assert smooth_losses(points)[20] == pytest.approx(total / sum(weights))


def run_range_test(tmp_path: Path, loss: str = "loss") -> LrRangeResult:
    registry.use_plugin(write_learner(tmp_path, loss))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    config = TrainingConfig(frames=60, crop=16, sequence_length=3)
    return find_learning_rate("blur", [clip], tmp_path / "range", config)


def test_the_rate_grows_by_one_factor_from_a_millionth_to_a_tenth(tmp_path):
    rates = [point.learning_rate for point in run_range_test(tmp_path).points]
    assert rates[0] == pytest.approx(1e-6)
    factors = [after / before for before, after in zip(rates, rates[1:], strict=False)]
    assert factors == pytest.approx([1e5 ** (1 / 20)] * len(factors))


def test_every_point_is_in_a_table_and_a_figure(tmp_path):
    result = run_range_test(tmp_path)
    with result.table.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["loss"]) for row in rows] == [point.loss for point in result.points]
    assert result.figure.read_bytes().startswith(b"\x89PNG")


def test_a_loss_that_is_not_finite_ends_the_test(tmp_path):
    result = run_range_test(tmp_path, 'loss * (1e39 if clip.name == "sequence 7" else 1)')
    assert len(result.points) == 7


def test_a_loss_that_has_doubled_ends_the_test(tmp_path):
    result = run_range_test(tmp_path, "loss * (9 if int(clip.name.split()[1]) > 9 else 1)")
    assert 9 < len(result.points) < 20


TRANSFORMS = {"plain": lambda loss: loss, "offset": lambda loss: loss - 7, "logarithm": math.log}


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=list(TRANSFORMS))
def test_a_falling_loss_of_either_sign_does_not_end_the_test(transform):
    falling = [
        LrPoint(k, 10 ** (-6 + k / 20), transform(0.1 - 0.0008 * k + 0.004 * (-1) ** k))
        for k in range(101)
    ]
    assert not any(_has_diverged(falling[:count]) for count in range(102))


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=list(TRANSFORMS))
def test_a_loss_of_either_sign_that_rises_above_where_it_began_ends_the_test(transform):
    points = [point._replace(loss=transform(1 + point.loss)) for point in valley(-4.0)]
    first = next(count for count in range(52) if _has_diverged(points[:count]))
    assert -2.1 < math.log10(points[first - 1].learning_rate) < -1.6


def test_noise_around_a_constant_loss_does_not_end_the_test():
    noise = np.random.default_rng(0).normal(-0.05, 0.01, (20, 101))
    for losses in noise:
        points = [LrPoint(k, 10 ** (-6 + k / 20), loss) for k, loss in enumerate(losses)]
        assert not any(_has_diverged(points[:count]) for count in range(102))

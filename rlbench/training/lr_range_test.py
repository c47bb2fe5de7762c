"""The learning-rate range test: train while the rate grows, and see where the loss falls."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rlbench import registry
from rlbench.system import paths
from rlbench.training.batches import Batches, sample_budget
from rlbench.training.config import TrainingConfig
from rlbench.training.progress import Progress
from rlbench.training.task import TrainingTask
from rlbench.training.train_state import NotFiniteError, TrainState

LOW, HIGH = 1e-6, 1e-1  # learning rates at the first and at the last sequence
BLUR = 0.25  # standard deviation of the window that losses are averaged in, decades of the rate
DIVERGED = 2.0  # times the least averaged loss at which the test is over
BELOW = 10.0  # how far below the rate of the least loss the peak is proposed


class Point(NamedTuple):
    """One sequence of the test."""

    frames: int  # seen before it
    rate: float  # learning rate
    loss: float


@dataclass(frozen=True)
class LrRangeResult:
    """What a range test found."""

    points: tuple[Point, ...]
    peak: float  # learning rate that is proposed
    table: Path  # all points as CSV
    figure: Path  # the same as PNG


def run(
    name: str,
    train_on: Sequence[Path],
    out: Path,
    plan: TrainingConfig,
    device: str = "cpu",
    report: Callable[[Progress, float], None] = lambda progress, loss: None,
) -> LrRangeResult:
    """Train `name` from its first weights over `plan.frames`, the rate rising from 1e-6 to 1e-1.

    The rate grows by the same factor with every frame; a network that has a share of it keeps its
    share. The test ends early where the loss is no longer finite or, averaged, twice its least.
    What is proposed as peak is a tenth of the rate at which the averaged loss is least.

    Smith 2017, Cyclical Learning Rates for Training Neural Networks, section 3.3. Differs: the rate
    grows geometrically, since it spans five decades, and the peak is a rule of thumb, where Smith
    reads the bounds off the curve: do look at it.
    """
    trainer: TrainingTask = registry.training_task(name, device, plan.seed)
    learner = TrainState(trainer, plan.norm, plan.average, plan.half, device)
    batches = Batches.planned(train_on, plan, trainer.method.traits, device)
    points: list[Point] = []
    progress = Progress()
    while progress.seen < plan.frames and not _diverged(points):
        done = progress.seen / plan.frames
        rate, clip = LOW * (HIGH / LOW) ** done, batches.sequence(progress.draws)
        spp = sample_budget(plan.spp or trainer.spp, plan.seed, progress.draws)
        try:
            loss = learner.sequence(clip, spp, rate / trainer.max_lr, done)
        except NotFiniteError:
            break
        points.append(Point(progress.seen, rate, loss))
        progress.seen += len(clip) * clip.size.n
        progress.draws += 1
        report(progress, loss)
    peak = proposed(points)
    return LrRangeResult(tuple(points), peak, _table(points, out), _figure(name, points, peak, out))


def averaged(points: Sequence[Point]) -> list[float]:
    """The losses, each the mean of its neighbours under a Gaussian in the rate's logarithm."""
    decades = np.log10([point.rate for point in points])
    losses = np.array([point.loss for point in points])
    away = (decades[:, None] - decades[None, :]) / BLUR
    weights = np.exp(-(away**2) / 2)
    return [float(value) for value in weights @ losses / weights.sum(1)]


def proposed(points: Sequence[Point]) -> float:
    """A tenth of the rate at which the averaged loss is least; nan without a point."""
    if not points:
        return math.nan
    smooth = averaged(points)
    return points[smooth.index(min(smooth))].rate / BELOW


def _diverged(points: Sequence[Point]) -> bool:
    """Is the averaged loss far above its least, at the end of at least two decades?"""
    if not points or points[-1].rate < 100 * LOW:
        return False
    smooth = averaged(points)
    return smooth[-1] > DIVERGED * min(smooth)


def _table(points: Sequence[Point], out: Path) -> Path:
    file = out / "range.csv"
    with paths.replacing(file) as temporary, temporary.open("w", newline="") as opened:
        writer = csv.writer(opened)
        writer.writerow((*Point._fields, "averaged"))
        smooth = averaged(points) if points else []
        writer.writerows((*point, mean) for point, mean in zip(points, smooth, strict=True))
    return file


def _figure(name: str, points: Sequence[Point], peak: float, out: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    rates = [point.rate for point in points]
    axes.plot(rates, [point.loss for point in points], ".", color="0.7", label="one sequence")
    if points:
        axes.plot(rates, averaged(points), label="averaged")
        axes.axvline(peak, color="0.4", linestyle="--", label=f"a tenth of the least: {peak:.1e}")
    axes.set(xscale="log", xlabel="learning rate", ylabel="loss", title=name)
    axes.legend()
    file = out / "range.png"
    with paths.replacing(file) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return file

"""Learning-rate range test: python -m rlbench.training.lr_find ours --frames 1200.

It trains while the rate grows, and finds where the loss is least.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rlbench import registry
from rlbench.system import paths
from rlbench.training import dataset
from rlbench.training.batches import Batches, sequence_budget
from rlbench.training.run_folder import run_folder
from rlbench.training.task import TrainingConfig, TrainingTask
from rlbench.training.train_state import NonFiniteStepError, TrainState

MIN_LR, MAX_LR = 1e-6, 1e-1  # learning rates of the first and the last sequence
WINDOW_DECADES = 0.25  # standard deviation of the Gaussian that smooths the losses
NOISE_MARGIN = 3.0  # a rise counts from so many times the usual step between two losses
MARGIN = 10.0  # the suggested rate is so many times lower than that of the least loss
COLUMNS = ("frames", "rate", "loss", "averaged")  # of the table


class LrPoint(NamedTuple):
    """One sequence of the test."""

    frames_seen: int  # before it
    learning_rate: float
    loss: float


@dataclass(frozen=True)
class LrRangeResult:
    """The measured losses, and the learning rate that they suggest."""

    points: tuple[LrPoint, ...]
    suggested_lr: float  # for `TrainingTask.max_lr`; nan if the first loss was not finite
    table: Path  # all points, CSV
    figure: Path  # loss against learning rate, PNG


def find_learning_rate(
    method: str, train_clips: Sequence[Path], out: Path, config: TrainingConfig, device: str = "cpu"
) -> LrRangeResult:
    """Train a method from its initial weights over `config.frames`, at rates from 1e-6 to 1e-1.

    The rate grows by the same factor with every frame; networks with an lr multiplier keep it. The
    test ends early if the loss is not finite, or if the smoothed loss has risen by more than it had
    fallen before, and beyond its noise. That depends on differences alone, because the logarithm of
    a loss is negative, so that twice its minimum is below it. The suggested rate is a tenth of the
    rate at which the smoothed loss is least. Writes range.csv and range.png to `out`.

    Smith 2017, Cyclical Learning Rates for Training Neural Networks, section 3.3. Differs from it:
    the rate grows geometrically, since it spans five decades, and the suggestion is a rule of
    thumb, where Smith reads the bounds off the curve. So look at the figure.

    Raises PluginError if the method has nothing to train, and BatchError if no crops can be cut
    from the clips.
    """
    task: TrainingTask = registry.training_task(method, device, config.seed)
    state = TrainState(task, config, device)
    batches = Batches.from_config(train_clips, config, task.method.traits, device)
    points: list[LrPoint] = []
    frames_seen = 0
    while frames_seen < config.frames and not _has_diverged(points):
        fraction, index = frames_seen / config.frames, len(points)
        learning_rate = MIN_LR * (MAX_LR / MIN_LR) ** fraction
        clip = batches.sequence(index)
        spp = sequence_budget(clip, config.spp or task.spp, config.seed, index)
        try:
            loss = state.train_sequence(clip, spp, learning_rate / task.max_lr, fraction)
        except NonFiniteStepError:
            break
        points.append(LrPoint(frames_seen, learning_rate, loss))
        frames_seen += len(clip) * clip.size.n
    suggested = suggest_lr(points)
    table, figure = _write_table(points, out), _plot(method, points, suggested, out)
    return LrRangeResult(tuple(points), suggested, table, figure)


def smooth_losses(points: Sequence[LrPoint]) -> list[float]:
    """The losses, averaged with a Gaussian window over the logarithm of the learning rate."""
    decades = np.log10([point.learning_rate for point in points])
    losses = np.array([point.loss for point in points])
    distances = (decades[:, None] - decades[None, :]) / WINDOW_DECADES
    weights = np.exp(-(distances**2) / 2)
    return [float(value) for value in weights @ losses / weights.sum(1)]


def suggest_lr(points: Sequence[LrPoint]) -> float:
    """A tenth of the learning rate at which the smoothed loss is least; nan without points."""
    if not points:
        return math.nan
    smooth = smooth_losses(points)
    return points[smooth.index(min(smooth))].learning_rate / MARGIN


def _has_diverged(points: Sequence[LrPoint]) -> bool:
    """Whether the smoothed loss rose by more than it fell and than noise, after two decades.

    The noise is the median of the steps between successive losses, which one jump does not change.
    """
    if not points or points[-1].learning_rate < 100 * MIN_LR:
        return False
    smooth = smooth_losses(points)
    fall, rise = smooth[0] - min(smooth), smooth[-1] - min(smooth)
    noise = float(np.median(np.abs(np.diff([point.loss for point in points]))))
    return rise > max(fall, NOISE_MARGIN * noise)


def _write_table(points: Sequence[LrPoint], out: Path) -> Path:
    file = out / "range.csv"
    with paths.atomic_write(file) as temporary, temporary.open("w", newline="") as opened:
        writer = csv.writer(opened)
        writer.writerow(COLUMNS)
        smooth = smooth_losses(points) if points else []
        writer.writerows((*point, mean) for point, mean in zip(points, smooth, strict=True))
    return file


def _plot(method: str, points: Sequence[LrPoint], suggested: float, out: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    rates = [point.learning_rate for point in points]
    axes.plot(rates, [point.loss for point in points], ".", color="0.7", label="one sequence")
    if points:
        axes.plot(rates, smooth_losses(points), label="smoothed")
        axes.axvline(suggested, color="0.4", linestyle="--", label=f"suggested: {suggested:.1e}")
    axes.set(xscale="log", xlabel="learning rate", ylabel="loss", title=method)
    axes.legend()
    file = out / "range.png"
    with paths.atomic_write(file) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return file


def main(argv: Sequence[str] | None = None) -> str:
    """What the test of the given command-line arguments proposes."""
    parser = argparse.ArgumentParser("python -m rlbench.training.lr_find", description=__doc__)
    parser.add_argument("method")
    parser.add_argument("--plugin", type=Path, help="a Python file with the method")
    parser.add_argument("--frames", type=int, default=1200, help="crops to train on")
    parser.add_argument("--crop", type=int, default=128, help="side of a crop in pixels")
    parser.add_argument("--bf16", action="store_true", help="bfloat16 forward pass")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="parent of NAME-range")
    parser.add_argument(
        "--clips", nargs="+", help="clip folders; default: those of preset train, rendered first"
    )
    options = parser.parse_args(argv)
    if options.plugin:
        registry.use_plugin(options.plugin)
    pool = registry.get_variant(options.method).traits.pool
    clips = dataset.select_split(None, None, None, {pool}, clips=options.clips or ()).train
    config = TrainingConfig(options.frames, crop=options.crop, bf16=options.bf16)
    folder = run_folder(options.out, options.method, suffix="-range")
    result = find_learning_rate(options.method, clips, folder, config, options.device)
    return f"proposed peak learning rate {result.suggested_lr:.1e}; see {result.figure}"


if __name__ == "__main__":
    import sys

    sys.stdout.write(main() + "\n")

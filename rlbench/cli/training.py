"""The commands train, lr-find, replay and crossval."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Budgets, Seeds
from rlbench.cli.plugins import load_plugins

if TYPE_CHECKING:
    from rlbench.training.config import TrainingConfig
    from rlbench.training.dataset import TrainingSplit
    from rlbench.training.runs import TrainingRuns

__all__ = ["crossval", "lr_find", "replay", "train"]

DEFAULT_FRAMES, DEFAULT_CROP = 12_000, 128  # those of TrainingConfig

RunsFolder = Annotated[
    Path,
    typer.Option(
        file_okay=False,
        metavar="FOLDER",
        help="folder of weights, checkpoints and logs",
        rich_help_panel=options.OUTPUT,
    ),
]


def train(
    methods: options.Methods = ["all"],  # noqa: B006 - Typer reads it and never changes it
    plugin: options.Plugins = None,
    frames: options.Frames = DEFAULT_FRAMES,
    batch: options.Batch = 1,
    crop: options.Crop = DEFAULT_CROP,
    train_spp: options.TrainSpp = options.DEFAULT_TRAIN_SPP,
    bf16: options.TrainBf16 = False,
    max_grad_norm: options.MaxGradNorm = 1.0,
    seed: options.TrainSeed = 0,
    minutes: options.Minutes = None,
    restart: Annotated[
        bool,
        typer.Option(
            "--restart/--resume",
            help="start again and keep the old run as NAME.old-N, or resume it",
            rich_help_panel=options.TRAINING,
        ),
    ] = False,
    allow_config_change: options.AllowConfigChange = False,
    preset: options.TrainPreset = None,
    seeds: options.SceneSeeds = None,
    holdout: options.Holdout = None,
    device: options.Device = "auto",
    out: RunsFolder = Path("runs"),
) -> None:
    """Train methods, or resume their training.

    The clips are generated scenes, none of which belongs to a test set. With --holdout, they are
    all test scenes of a preset except one, as in the papers. docs/how-to/train-a-method.md
    describes the training.

    Examples:

    \b
      rlbench train --methods ours,ntas
      rlbench train -m ours --minutes 30 --device cuda
      rlbench train -m ours --seeds 0:48 --train-spp 0.5,1
      rlbench train -m ntas --holdout hall --preset standard
    """
    load_plugins(plugin)
    from rlbench.training.logger import tensorboard_hint
    from rlbench.training.runs import archive_run

    config = _config(frames, batch, crop, seed, max_grad_norm, bf16, train_spp)
    runs = _runs(out, config, device, minutes, allow_config_change)
    names = _trainable(methods)
    runs.check(names)
    split = _split(names, preset, seeds, holdout)
    if names and (hint := tensorboard_hint()):
        typer.echo(hint, err=True)
    for name in names:
        folder = runs.folder(name, holdout)
        if restart and (archived := archive_run(folder)):
            typer.echo(f"{name}: the old run is now in {archived}")
        runs.train(name, split, holdout)
        typer.echo(f"{name}: {folder}")


def lr_find(
    methods: options.Methods,
    plugin: options.Plugins = None,
    frames: options.Frames = DEFAULT_FRAMES,
    batch: options.Batch = 1,
    crop: options.Crop = DEFAULT_CROP,
    train_spp: options.TrainSpp = options.DEFAULT_TRAIN_SPP,
    bf16: options.TrainBf16 = False,
    max_grad_norm: options.MaxGradNorm = 1.0,
    seed: options.TrainSeed = 0,
    preset: options.TrainPreset = None,
    seeds: options.SceneSeeds = None,
    holdout: options.Holdout = None,
    device: options.Device = "auto",
    out: RunsFolder = Path("runs"),
) -> None:
    """Propose a learning rate by a range test.

    Trains from the first weights while the learning rate grows, and writes range.csv and range.png
    to NAME-range. Smith 2017.

    Examples:

    \b
      rlbench lr-find -m ours --frames 1200
      rlbench lr-find -m mine --plugin mine.py --frames 1200
    """
    load_plugins(plugin)
    config = _config(frames, batch, crop, seed, max_grad_norm, bf16, train_spp)
    runs = _runs(out, config, device)
    names = _trainable(methods)
    runs.check(names)
    split = _split(names, preset, seeds, holdout)
    for name in names:
        result = runs.find_learning_rate(name, split)
        typer.echo(
            f"{name}: proposed peak learning rate {result.suggested_lr:.1e}; see {result.figure}"
        )


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            exists=True,
            dir_okay=False,
            help="failed-sequence-N.safetensors of a run",
        ),
    ],
    device: options.Device = "auto",
    plugin: options.Plugins = None,
) -> None:
    """Repeat the training steps that stopped a run.

    Says which layer gives values that are not finite. The run itself is unchanged.

    Examples:

    \b
      rlbench replay runs/ours/failed-sequence-71.safetensors
    """
    load_plugins(plugin)
    from rlbench.benchmark.api import select_device
    from rlbench.training import replay_sequence

    failure = replay_sequence(file, str(select_device(device)))
    typer.echo(f"failed again: {failure}" if failure else "all values are finite on this machine")


def crossval(
    methods: options.Methods = ["all"],  # noqa: B006 - Typer reads it and never changes it
    plugin: options.Plugins = None,
    preset: options.Preset = "mini",
    scenes: options.Scenes = None,
    spp: options.Spp = options.DEFAULT_SPP,
    cost: options.Cost = "measured",
    limit_frames: options.LimitFrames = None,
    frames: options.Frames = DEFAULT_FRAMES,
    batch: options.Batch = 1,
    crop: options.Crop = DEFAULT_CROP,
    train_spp: options.TrainSpp = options.DEFAULT_TRAIN_SPP,
    bf16: options.TrainBf16 = False,
    max_grad_norm: options.MaxGradNorm = 1.0,
    seed: options.TrainSeed = 0,
    minutes: options.Minutes = None,
    allow_config_change: options.AllowConfigChange = False,
    device: options.Device = "auto",
    out: Annotated[
        Path,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder of one training run per scene, and of results/",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("crossval"),
) -> None:
    """Train on all scenes but one, and score on that one.

    Repeats this for each scene, or for --scenes only: the protocol of Scardigli et al. 2023. Rows
    are named METHOD@crossval; methods without anything to train keep their names. A killed
    cross-validation resumes.

    Examples:

    \b
      rlbench crossval --methods ours,ntas
      rlbench crossval -m ours,svgf --preset standard --frames 6000 --bf16
      rlbench report all --results crossval/results --out crossval/report
    """
    load_plugins(plugin)
    from rlbench.benchmark import crossval as protocol
    from rlbench.benchmark.api import select_device
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console

    names = arguments.expand_methods(methods)
    config = _config(frames, batch, crop, seed, max_grad_norm, bf16, train_spp)
    runs = _runs(out, config, device, minutes, allow_config_change)
    runs.check([name for name in map(protocol.variant_to_train, names) if name])
    folds = protocol.folds(preset, arguments.split_names(scenes), names)
    clips = tuple(clip for fold in folds for clip in fold.clips)
    plan = RunPlan(
        names, clips, spp, (seed,), select_device(device), cost, limit_frames=limit_frames
    )
    results = out / "results"
    summary = protocol.crossval(folds, runs, plan, results, typer.echo, console.measuring)
    console.print_summary(summary, results)
    console.print_scores(plan, results, protocol.row_names(plan))


def _config(
    frames: int,
    batch: int,
    crop: int,
    seed: int,
    max_grad_norm: float,
    bf16: bool,
    train_spp: Budgets,
) -> TrainingConfig:
    from rlbench.training.config import TrainingConfig

    return TrainingConfig(
        frames, batch, crop, seed=seed, max_grad_norm=max_grad_norm, bf16=bf16, spp=train_spp
    )


def _runs(
    out: Path,
    config: TrainingConfig,
    device: str,
    minutes: float | None = None,
    allow_config_change: bool = False,
) -> TrainingRuns:
    from rlbench.benchmark.api import select_device
    from rlbench.cli import console
    from rlbench.training.runs import TrainingRuns

    return TrainingRuns(
        out,
        config,
        str(select_device(device)),
        math.inf if minutes is None else minutes,
        shlex.join(["rlbench", *sys.argv[1:]]),
        allow_config_change,
        console.training,
    )


def _trainable(patterns: list[str]) -> list[str]:
    """The selected methods that can be trained; reports the others."""
    from rlbench.training.runs import select_trainable

    names = arguments.expand_methods(patterns, pretrained_only=False)
    trainable = select_trainable(names)
    for name in names:
        if name not in trainable:
            typer.echo(f"{name} has nothing to train")
    return trainable


def _split(
    names: list[str], preset: str | None, seeds: Seeds | None, holdout: str | None
) -> TrainingSplit:
    """Clips for the training of these methods; renders those that are missing."""
    from rlbench import registry
    from rlbench.training import dataset

    if not names:
        return dataset.EMPTY_SPLIT
    pools = {registry.get_variant(name).traits.pool for name in names}
    return dataset.select_split(preset, seeds, holdout, pools)

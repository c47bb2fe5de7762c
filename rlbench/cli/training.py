"""The command train."""

from __future__ import annotations

import math
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options, training_clips, training_options, training_queue
from rlbench.cli.arguments import Budgets
from rlbench.cli.plugins import load_plugins
from rlbench.cli.verbosity import note

if TYPE_CHECKING:
    from rlbench.training.config import TrainingConfig
    from rlbench.training.runs import TrainingRuns

__all__ = ["train", "training_config", "training_runs"]


def train(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    frames: training_options.TrainFrames = None,
    batch: training_options.Batch = 1,
    crop: training_options.Crop = training_options.DEFAULT_CROP,
    train_spp: training_options.TrainSpp = training_options.DEFAULT_SPP,
    bf16: training_options.Bf16 = False,
    max_grad_norm: training_options.MaxGradNorm = 1.0,
    seed: training_options.Seed = 0,
    eval_interval: training_options.EvalInterval = 1000,
    start: training_options.Start = None,
    minutes: training_options.Minutes = None,
    restart: Annotated[
        bool,
        typer.Option(
            "--restart/--resume",
            help="start again and keep the old run as NAME.old-N, or resume it",
            rich_help_panel=training_options.TRAINING,
        ),
    ] = False,
    allow_config_change: training_options.AllowConfigChange = False,
    quick: training_options.Quick = False,
    preset: training_options.Preset = None,
    seeds: options.SceneSeeds = None,
    clips: training_options.Clips = None,
    mix: training_options.Mix = None,
    validate: training_options.Validate = None,
    keep: training_options.Keep = "last",
    holdout: training_options.Holdout = None,
    device: options.Device = "auto",
    out: training_options.RunsFolder = Path("runs"),
    queue: training_options.Queue = None,
    status: training_options.Status = False,
    pause: training_options.Pause = None,
) -> None:
    """Train methods, or resume their training.

    The clips are generated scenes, none of which belongs to a test set; missing ones are rendered
    first. With --clips, they are your own, alone or mixed with those of --preset. With --holdout,
    they are all test scenes of a preset except one, as in the papers. With --quick, they are
    procedural and there at once, and the run lies in NAME-quick. With --queue, a file lists many
    trainings. docs/how-to/train-a-method.md describes the training.

    Examples:

    \b
      rlbench train -m mine --plugin mine.py --quick
      rlbench train --methods ours,ntas
      rlbench train -m ours --minutes 30 --device cuda
      rlbench train -m ours --seeds 0:40 --train-spp 0.5,1
      rlbench train -m ours --clips my_clips/ --preset train --mix 0.7
      rlbench train -m ours --clips 'shots/*' --validate development,mine=held_out/ --keep best
      rlbench train -m ntas --holdout hall --preset standard
      rlbench train -m ours/paper --start ours/paper-A2 --frames 20000
      rlbench train --queue campaign.toml --out runs/campaign
      rlbench train --queue campaign.toml --out runs/campaign --status
    """
    if training_queue.has_options(context):
        training_queue.run_command(context)
        return
    load_plugins(plugin)
    names = arguments.trainable_methods(methods or ["all"])  # before torch
    from rlbench.parallel.executor import TimeLimit, TimeLimitedExecutor
    from rlbench.system.paths import check_writable
    from rlbench.training import dataset
    from rlbench.training.logger import tensorboard_hint
    from rlbench.training.run_folder import QUICK, find_weights
    from rlbench.training.runs import archive_run

    check_writable(out)
    limit = TimeLimit(math.inf if minutes is None else minutes)
    default = training_options.QUICK_FRAMES if quick else training_options.DEFAULT_FRAMES
    config = training_config(frames or default, batch, crop, seed, max_grad_norm, bf16, train_spp)
    config = replace(
        config,
        mix=training_clips.mix_share(mix, preset, seeds, clips),
        keep=keep,
        eval_interval=eval_interval,
    )
    runs = training_runs(out, config, device, minutes, allow_config_change)
    runs = replace(runs, suffix=QUICK if quick else "", start=find_weights(start, out))
    runs.check(names)
    if quick:
        training_clips.refuse_other_clips(preset, seeds, holdout, clips, validate)
        split = dataset.split_quick(training_clips.pool_kinds(names))
    else:
        if holdout is None:
            training_clips.announce_rendering(preset, seeds, clips)
        chosen = (preset, seeds, holdout, clips, validate)
        split = training_clips.select_split(names, *chosen, TimeLimitedExecutor(limit))
    for text in filter(None, (split.remark, tensorboard_hint())):
        note(text)
    if clips or validate:
        runs.check_clips(names, split)
        note(split.summary)
    runs = replace(runs, minutes=limit.minutes_left)
    for name in names:
        folder = runs.folder(name, holdout)
        if restart and (archived := archive_run(folder)):
            typer.echo(f"{name}: the old run is now in {archived}")
        runs.train(name, split, holdout)
        typer.echo(f"{name}: {folder}")


def training_config(
    frames: int,
    batch: int,
    crop: int,
    seed: int,
    max_grad_norm: float,
    bf16: bool,
    train_spp: Budgets,
) -> TrainingConfig:
    """The config of these options."""
    from rlbench.training.config import TrainingConfig

    return TrainingConfig(
        frames, batch, crop, seed=seed, max_grad_norm=max_grad_norm, bf16=bf16, spp=train_spp
    )


def training_runs(
    out: Path,
    config: TrainingConfig,
    device: str,
    minutes: float | None = None,
    allow_config_change: bool = False,
) -> TrainingRuns:
    """Runs with these options, a progress bar, and this command in their model cards."""
    from rlbench.benchmark.api import select_device
    from rlbench.cli import console
    from rlbench.system.bfloat16 import emulation_reason
    from rlbench.training.runs import TrainingRuns

    selected = str(select_device(device))
    if config.bf16 and (reason := emulation_reason(selected)):
        note(f"warning: {reason}; training is faster without --bf16")
    return TrainingRuns(
        out,
        config,
        selected,
        math.inf if minutes is None else minutes,
        _reproducing_command(sys.argv[1:]),
        allow_config_change,
        console.training,
    )


def _reproducing_command(words: list[str]) -> str:
    """The command for model cards, without the folders of this machine: names of paths alone.

    >>> _reproducing_command(["train", "-m", "ours/A1", "--clips", "/home/me/a,/home/me/b/"])
    'rlbench train -m ours/A1 --clips a,b/'
    """
    absolute = re.compile(r"(?<![^,=])[/~][^,=]*/(?=[^,/=]+)|(?<![^,=])[/~](?=[^,/=]+)")
    return shlex.join(["rlbench", *(absolute.sub("", word) for word in words)])

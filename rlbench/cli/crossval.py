"""The command crossval: train on all scenes but one, score on that one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.methods import expand_methods, load_plugins
from rlbench.cli.options import fill, folder
from rlbench.cli.train import training_runs
from rlbench.training.task import TrainingConfig


def crossval(
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    preset: options.Preset = "mini",
    scenes: options.Scenes = None,
    spp: options.Spp = options.DEFAULT_SPP,
    frames: options.Frames = None,
    minutes: options.Minutes = None,
    out: Annotated[Path, folder("folder of one training run per scene, and of results/")] = Path(
        "crossval"
    ),
    cost: options.Cost = "measured",
    limit_frames: options.LimitFrames = None,
    batch: options.Batch = 1,
    crop: options.Crop = TrainingConfig.crop,
    train_spp: options.TrainSpp = options.DEFAULT_TRAIN_SPP,
    bf16: options.TrainBf16 = False,
    max_grad_norm: options.MaxGradNorm = 1.0,
    seed: options.TrainSeed = 0,
    allow_config_change: options.AllowConfigChange = False,
    device: options.Device = "auto",
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
    names = expand_methods(methods, default="all")  # before torch
    from rlbench.benchmark.planning import check_run, select_device
    from rlbench.benchmark.run_outcome import read_outcome
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console
    from rlbench.cli import crossval_folds as protocol

    frames = frames or options.DEFAULT_FRAMES
    config = fill(TrainingConfig, locals(), frames=frames, spp=train_spp)
    runs = training_runs(out, config, device, minutes, allow_config_change)
    runs.check([name for name in map(protocol.variant_to_train, names) if name])
    results = out / "results"
    check_run(names, spp, results, preset, cost)
    folds = protocol.folds(preset, split_names(scenes), names)
    clips = tuple(clip for fold in folds for clip in fold.clips)
    plan = RunPlan(
        names, clips, spp, (seed,), select_device(device), cost, limit_frames=limit_frames
    )
    summary = protocol.crossval(folds, runs, plan, results, typer.echo, console.measuring)
    outcome = read_outcome(plan, summary, results, protocol.row_names(plan))
    console.print_outcome(outcome)
    if not outcome.verdict.has_passed:
        raise typer.Exit(1)

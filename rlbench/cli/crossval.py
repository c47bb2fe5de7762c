"""The command crossval: train on all scenes but one, score on that one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options, training_options
from rlbench.cli.plugins import load_plugins
from rlbench.cli.training import training_config, training_runs

__all__ = ["crossval"]


def crossval(
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    preset: options.Preset = "mini",
    scenes: options.Scenes = None,
    spp: options.Spp = options.DEFAULT_SPP,
    cost: options.Cost = "measured",
    limit_frames: options.LimitFrames = None,
    frames: training_options.Frames = training_options.DEFAULT_FRAMES,
    batch: training_options.Batch = 1,
    crop: training_options.Crop = training_options.DEFAULT_CROP,
    train_spp: training_options.TrainSpp = training_options.DEFAULT_SPP,
    bf16: training_options.Bf16 = False,
    max_grad_norm: training_options.MaxGradNorm = 1.0,
    seed: training_options.Seed = 0,
    minutes: training_options.Minutes = None,
    allow_config_change: training_options.AllowConfigChange = False,
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
    names = arguments.expand_methods(methods, default="all")  # before torch
    from rlbench.benchmark import crossval as protocol
    from rlbench.benchmark.api import check_run, select_device
    from rlbench.benchmark.run_outcome import read_outcome
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console

    config = training_config(frames, batch, crop, seed, max_grad_norm, bf16, train_spp)
    runs = training_runs(out, config, device, minutes, allow_config_change)
    runs.check([name for name in map(protocol.variant_to_train, names) if name])
    check_run(names, spp, out / "results", preset, cost)
    folds = protocol.folds(preset, arguments.split_names(scenes), names)
    clips = tuple(clip for fold in folds for clip in fold.clips)
    plan = RunPlan(
        names, clips, spp, (seed,), select_device(device), cost, limit_frames=limit_frames
    )
    results = out / "results"
    summary = protocol.crossval(folds, runs, plan, results, typer.echo, console.measuring)
    outcome = read_outcome(plan, summary, results, protocol.row_names(plan))
    console.print_outcome(outcome)
    if not outcome.verdict.has_passed:
        raise typer.Exit(1)

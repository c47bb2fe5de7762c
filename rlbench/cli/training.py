"""The commands that train methods: by one plan, or leaving out one scene after another."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments
from rlbench.cli.clips import Scenes, Seeds
from rlbench.cli.methods import Device, Methods, Plugins, load_plugins
from rlbench.training.config import TrainingConfig

Frames = Annotated[int, typer.Option(min=1, help="crops to see, for each method")]
Minutes = Annotated[
    float | None, typer.Option(help="stop after so many, for each method; default never")
]
Batch = Annotated[int, typer.Option(min=1, help="crops advanced together")]
Crop = Annotated[int, typer.Option(min=16, help="side of a crop, pixels")]
Half = Annotated[bool, typer.Option("--half", help="bfloat16 forward pass")]
Norm = Annotated[float, typer.Option(help="gradients are clipped to this length")]
Budget = Annotated[
    str, typer.Option(help="samples per pixel, 4 or 0.5,1,2, one drawn a sequence; any: its own")
]
Altered = Annotated[
    bool, typer.Option("--altered", help="go on from a checkpoint of another plan; the card tells")
]


def train(
    methods: Methods = ["all"],  # noqa: B006
    out: Annotated[Path, typer.Option(help="weights, checkpoints and logs")] = Path("runs"),
    minutes: Minutes = None,
    frames: Frames = 12_000,
    batch: Batch = 1,
    crop: Crop = 128,
    budget: Budget = "any",
    half: Half = False,
    norm: Norm = 1.0,
    seed: int = 0,
    device: Device = "auto",
    preset: Annotated[str | None, typer.Option(help="default train; mini with --holdout")] = None,
    seeds: Seeds = None,
    holdout: Annotated[
        str | None, typer.Option(help="train on the scored scenes but this one")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh/--resume", help="start anew, and move the old training aside")
    ] = False,
    altered: Altered = False,
    range_test: Annotated[
        bool, typer.Option("--range-test", help="no training: try learning rates, --frames long")
    ] = False,
    replay: Annotated[
        Path | None, typer.Option(help="the file of a halted sequence: take its steps again")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Train methods on generated scenes, none of which is scored on; goes on where it stopped.

    With --holdout it is the papers' protocol instead: all scored scenes but one, the one to score.
    See docs/training.md.

    Examples:

      rlbench train --methods ours,ntas

      rlbench train -m ours --minutes 30 --device cuda

      rlbench train -m ours --seeds 0:48 --budget 0.5,1

      rlbench train -m ntas --holdout hall --preset standard

      rlbench train -m mine --plugin mine.py --range-test --frames 1200

      rlbench train --replay runs/ours/failed-sequence-71.safetensors
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.cli import console
    from rlbench.training import dataset, logger, runs

    if replay is not None:
        from rlbench.training import replay_sequence

        found = replay_sequence(replay, str(arguments.device(device)))
        typer.echo(f"again: {found}" if found else "all is finite this time, on this machine")
        return
    names = arguments.methods(methods, trained=False)
    learning = runs.select_trainable(names)
    for name in set(names) - set(learning):
        typer.echo(f"{name} has nothing to train")
    plan = planned(frames, batch, crop, budget, half, norm, seed)
    command = shlex.join(["rlbench", *sys.argv[1:]])
    lessons = runs.TrainingRuns(
        out,
        plan,
        str(arguments.device(device)),
        arguments.minutes(minutes),
        command,
        altered,
        console.training,
    )
    lessons.check(learning)
    kinds = {registry.get_variant(name).traits.pool for name in learning}
    chosen = dataset.EMPTY_SPLIT
    if learning:
        chosen = dataset.select_split(preset, arguments.seeds(seeds), holdout, kinds)
        typer.echo(logger.tensorboard_hint(), err=True) if logger.tensorboard_hint() else None
    for name in learning:
        if range_test:
            tried = lessons.find_learning_rate(name, chosen)
            typer.echo(f"{name}: peak {tried.suggested_lr:.1e} proposed; see {tried.figure}")
            continue
        folder = lessons.folder(name, holdout)
        if fresh and (old := runs.archive_run(folder)):
            typer.echo(f"{name}: the training that was there is in {old} now")
        lessons.train(name, chosen, holdout)
        typer.echo(f"{name}: {folder}")


def crossval(
    methods: Methods = ["all"],  # noqa: B006
    preset: Annotated[str, typer.Option(help="of scenes that are scored")] = "mini",
    scenes: Scenes = None,
    spp: Annotated[str, typer.Option(help="budgets to score at")] = "0.5,1,2,4",
    frames: Frames = 12_000,
    minutes: Minutes = None,
    batch: Batch = 1,
    crop: Crop = 128,
    budget: Budget = "any",
    half: Half = False,
    norm: Norm = 1.0,
    seed: int = 0,
    device: Device = "auto",
    out: Annotated[Path, typer.Option(help="a training each scene, and results/")] = Path(
        "crossval"
    ),
    cost: Annotated[
        str, typer.Option(help="time of a sample: measured, paper-2080ti, or a TOML file")
    ] = "measured",
    limit_frames: Annotated[
        int | None, typer.Option(min=1, help="score the first frames only, for trying out")
    ] = None,
    altered: Altered = False,
    plugin: Plugins = None,
) -> None:
    """Train on all scenes but one, score on that one, for each scene in turn; goes on if killed.

    The protocol of Scardigli et al. 2023. In the results such rows are called NAME@crossval;
    methods that learn nothing are scored beside them. --scenes leaves out these alone.

    Examples:

      rlbench crossval --methods ours,ntas

      rlbench crossval -m ours,svgf --preset standard --frames 6000 --half

      rlbench report all --results crossval/results --out crossval/report
    """
    load_plugins(plugin)
    from rlbench.benchmark import crossval as leaving
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console
    from rlbench.training import runs

    names = arguments.methods(methods)
    plan = planned(frames, batch, crop, budget, half, norm, seed)
    where, command = arguments.device(device), shlex.join(["rlbench", *sys.argv[1:]])
    lessons = runs.TrainingRuns(
        out,
        plan,
        str(where),
        arguments.minutes(minutes),
        command,
        altered,
        console.training,
    )
    lessons.check([name for name in map(leaving.variant_to_train, names) if name])
    folds = leaving.folds(preset, arguments.split(scenes or []), names)
    clips = tuple(clip for fold in folds for clip in fold.clips)
    budgets = arguments.numbers("--spp", spp, float)
    request = RunPlan(names, clips, budgets, (seed,), where, cost, limit_frames=limit_frames)
    results = out / "results"
    done = leaving.crossval(folds, lessons, request, results, typer.echo, console.progress)
    console.done(done, results)
    console.table(request, results, leaving.row_names(request))


def planned(
    frames: int, batch: int, crop: int, budget: str, half: bool, norm: float, seed: int
) -> TrainingConfig:
    """The plan that the options of a command ask for. Raises AskedError."""
    arguments.positive("--norm", norm)
    spp = () if budget == "any" else arguments.numbers("--budget", budget, float)
    return TrainingConfig(frames, batch, crop, seed=seed, max_grad_norm=norm, bf16=half, spp=spp)

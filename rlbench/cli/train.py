"""The command train: train methods, on clips that are rendered or the user's own."""

from __future__ import annotations

import math
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import Seeds, parse_keep, parse_share, split_names
from rlbench.cli.methods import load_plugins, plugin_words, pool_kinds, trainable_methods
from rlbench.cli.options import CLIPS, TRAINING, complete_names, fill, flag, folder, option
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError
from rlbench.training.task import TrainingConfig

if TYPE_CHECKING:
    from rlbench.training.loop import TrainingRuns

QUEUE = "Queue"  # title of a group of options
QUICK_FRAMES = 600
DEFAULT_MIX = 0.5


def train(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    quick: Annotated[
        bool,
        flag(
            CLIPS,
            "--quick",
            "try a training: on procedural clips, which need no rendering, not for results",
        ),
    ] = False,
    frames: options.Frames = None,
    clips: Annotated[
        list[str] | None,
        option(
            CLIPS,
            "clips of your own to train on, folders, patterns or presets a,b, alone or mixed "
            "with --preset; can be repeated",
            value="FOLDERS",
        ),
    ] = None,
    minutes: options.Minutes = None,
    device: options.Device = "auto",
    out: Annotated[Path, folder("folder of weights, checkpoints and logs")] = Path("runs"),
    preset: Annotated[
        str | None,
        option(
            CLIPS,
            "clips to train on, a or a,b; default: train, or mini with --holdout",
            value="PRESETS",
            complete=complete_names("presets"),
        ),
    ] = None,
    size: options.Size = None,
    seeds: options.SceneSeeds = None,
    render_ahead: Annotated[
        int,
        option(
            CLIPS,
            "render this many further seeds of --preset in a second process, those of several "
            "presets in turn; each replaces the oldest clip; 0: none",
            value="CLIPS",
            min=0,
        ),
    ] = 0,
    mix: Annotated[
        float | None,
        option(
            CLIPS,
            "share of the crops from --clips where --preset is given too; default: 0.5",
            value="SHARE",
            parse=parse_share,
        ),
    ] = None,
    validate: Annotated[
        list[str] | None,
        option(
            CLIPS,
            "clips to validate on: folders, or presets for decisions such as development, a,b; "
            "each is a set with a curve; default: some of those to train on",
            value="[NAME=]SET",
        ),
    ] = None,
    holdout: Annotated[
        str | None,
        option(CLIPS, "train on the test scenes of the preset except this one", value="SCENE"),
    ] = None,
    batch: options.Batch = 1,
    crop: options.Crop = TrainingConfig.crop,
    sequence_length: Annotated[
        int,
        option(
            TRAINING,
            "consecutive frames that a crop is taken from, and gradients pass through; clips with "
            "fewer give what they have",
            value="FRAMES",
            min=1,
        ),
    ] = TrainingConfig.sequence_length,
    train_spp: options.TrainSpp = options.DEFAULT_TRAIN_SPP,
    bf16: options.TrainBf16 = False,
    graph: Annotated[
        bool | None,
        flag(
            TRAINING,
            "--graph/--no-graph",
            "record each step as a CUDA graph, or not; default: on a GPU that replays a small one",
        ),
    ] = None,
    max_grad_norm: options.MaxGradNorm = 1.0,
    seed: options.TrainSeed = 0,
    eval_interval: Annotated[
        int,
        option(
            TRAINING,
            "crops between two validations, each of which writes a checkpoint",
            value="FRAMES",
            min=1,
        ),
    ] = 1000,
    keep: Annotated[
        str,
        option(
            TRAINING,
            "which averaged weights to save: the last ones, or those of the best validation, by "
            "the mean over the sets or by one of them",
            value="last|best|best:SET",
            parse=parse_keep,
        ),
    ] = "last",
    start: Annotated[
        str | None,
        option(
            TRAINING,
            "first weights of new runs: a weights file, a finished run in --out such as ours/A2, "
            "or else the shipped weights of that row; tensors of equal name and shape are taken",
            value="FILE|ROW",
        ),
    ] = None,
    anchor: Annotated[
        float,
        option(
            TRAINING,
            "keep weights that were trained before near their start (L2-SP); no such weight moves "
            "further than about 1 / WEIGHT; 0: free",
            value="WEIGHT",
            min=0,
        ),
    ] = 0.0,
    anneal: Annotated[
        float,
        option(
            TRAINING,
            "the learning rate rises and falls within these minutes of training, in place of "
            "--frames; 0: within --frames",
            value="MINUTES",
            min=0,
        ),
    ] = 0.0,
    until_flat: Annotated[
        float,
        option(
            TRAINING,
            "go on in cycles, the first of --frames, each later one as long as all before it, "
            "until one gains less than this on the mean over the validation sets; 0: one cycle",
            value="DB",
            min=0,
        ),
    ] = 0.0,
    most_frames: Annotated[
        int,
        option(
            TRAINING,
            "crops beyond which --until-flat begins no further cycle",
            value="FRAMES",
            min=1,
        ),
    ] = TrainingConfig.most_frames,
    restart: Annotated[
        bool,
        flag(
            TRAINING,
            "--restart/--resume",
            "start again and keep the old run as NAME.old-N, or resume it",
        ),
    ] = False,
    allow_config_change: options.AllowConfigChange = False,
    queue: Annotated[
        Path | None,
        option(
            QUEUE,
            "run the trainings that a TOML file lists, side by side; the same command resumes them",
            value="FILE",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    status: Annotated[
        bool, flag(QUEUE, "--status", "show how far the trainings of --queue are")
    ] = False,
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
      rlbench train -m ours --preset train-windows,train-hard-windows --start ours
      rlbench train -m ours --preset train-hard --render-ahead 1000 --frames 100000
      rlbench train -m ntas --holdout hall --preset standard
      rlbench train -m ours/paper --start ours/paper-A2 --frames 20000
      rlbench train -m ours --start ours --anchor 30 --frames 30000
      rlbench train -m nppd --frames 20000 --until-flat 0.05
      rlbench train -m ours/paper --start ours/paper --sequence-length 12 --frames 20000
      rlbench train --queue research/campaign.toml --out runs/campaign
      rlbench train --queue research/campaign.toml --out runs/campaign --status
    """
    if queue is not None or status:
        from rlbench.cli import train_queue

        train_queue.run_command(context)
        return
    load_plugins(plugin)
    preset = _at_size(preset, size, holdout, clips)
    names = trainable_methods(methods or ["all"])  # before torch
    from rlbench.parallel.executor import TimeLimit, TimeLimitedExecutor
    from rlbench.system.paths import check_writable
    from rlbench.training import dataset
    from rlbench.training.loop import archive_run
    from rlbench.training.run_folder import QUICK, find_weights, tensorboard_hint

    check_writable(out)
    limit = TimeLimit(math.inf if minutes is None else minutes)
    config = fill(
        TrainingConfig,
        locals(),
        frames=frames or (QUICK_FRAMES if quick else options.DEFAULT_FRAMES),
        spp=train_spp,
        mix=_mix_share(mix, preset, seeds, clips),
    )
    runs = training_runs(out, config, device, minutes, allow_config_change, graph)
    runs = replace(runs, suffix=QUICK if quick else "", start=find_weights(start, out, names))
    runs.check(names)
    if quick:
        chosen = {"preset": preset, "seeds": seeds, "holdout": holdout, "clips": clips}
        _refuse_other_clips({**chosen, "validate": validate, "render-ahead": render_ahead or None})
        split = dataset.split_quick(pool_kinds(names))
    else:
        if holdout is None:
            _announce_rendering(preset, seeds, clips)
        split = dataset.select_split(
            preset,
            seeds,
            holdout,
            pool_kinds(names),
            TimeLimitedExecutor(limit),
            split_names(clips),
            split_names(validate),
            render_ahead,
        )
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
        weights = runs.train(name, split, holdout)
        typer.echo(f"{name}: {folder}")
        _say_if_stopped(name, folder, minutes)
        _name_next_command(name, weights, plugin)


def _say_if_stopped(name: str, folder: Path, minutes: float | None) -> None:
    """Say that the time of a training ended before its crops, and how to go on."""
    from rlbench.training.run_folder import read_state

    state = read_state(folder)
    if minutes is not None and state.frames_seen < state.frames:
        note(
            f"{name}: stopped after --minutes {minutes:g} with {state.frames_seen} of "
            f"{state.frames} crops; the same command goes on from there"
        )


def _name_next_command(name: str, weights: Path, plugin: list[Path] | None) -> None:
    """Say how the trained weights are scored; nothing if the training was stopped before any."""
    if weights.is_file():
        words = ["rlbench", "run", "-m", name, "--weights", f"{name}={weights}"]
        note(f"score it: {shlex.join(words)}{plugin_words(plugin)}")


def _at_size(
    preset: str | None,
    size: tuple[int, int] | None,
    holdout: str | None,
    clips: list[str] | None,
) -> str | None:
    """The names of the presets, a or a,b, at `size` pixels (height, width)."""
    if size is None:
        return preset
    if clips and preset is None:
        raise OptionError("--size is that of a preset's clips, and --clips names yours. Omit it")
    from rlbench.clips.presets import get_preset

    names = split_names([preset or ("mini" if holdout else "train")])
    return ",".join(get_preset(name, size).name for name in names)


def _mix_share(
    mix: float | None, preset: str | None, seeds: Seeds | None, clips: list[str] | None
) -> float:
    """The share of crops from --clips that are mixed in; 0 without clips of both kinds."""
    is_mixed = bool(clips) and (preset is not None or seeds is not None)
    if mix is not None and not is_mixed:
        raise OptionError(
            "--mix is the share of crops from --clips, the others are from --preset. Give both of "
            "them, or omit --mix"
        )
    return (mix or DEFAULT_MIX) if is_mixed else 0.0


def _announce_rendering(preset: str | None, seeds: Seeds | None, clips: list[str] | None) -> None:
    """Say how many training clips are rendered before the training begins."""
    from rlbench.clips.presets import find_preset
    from rlbench.training import dataset

    if clips and preset is None and seeds is None:
        return
    names = split_names([preset or "train"])
    # an error that suggests the nearest name follows for others
    counts = [dataset.count_unrendered(name, seeds) for name in names if find_preset(name)]
    missing, total = (sum(numbers) for numbers in zip((0, 0), *counts, strict=True))
    if missing:
        note(
            f"{missing} of {total} training clips have to be rendered first. --quick tries the "
            "training on clips that need no rendering"
        )


def _refuse_other_clips(chosen: Mapping[str, object]) -> None:
    """Raise OptionError for options that choose clips, which --quick has of its own."""
    if given := [option for option, value in chosen.items() if value is not None]:
        raise OptionError(
            f"--quick trains on clips of its own, and --{given[0]} chooses others. Omit one of them"
        )


def training_runs(
    out: Path,
    config: TrainingConfig,
    device: str,
    minutes: float | None = None,
    allow_config_change: bool = False,
    graph: bool | None = None,
) -> TrainingRuns:
    """Runs with these options, a progress bar, and this command in their model cards.

    `graph` records each step; None: on a GPU that replays a small graph.
    """
    from rlbench.benchmark.planning import select_device
    from rlbench.cli import console
    from rlbench.ops.recording import CudaGraphs, can_record
    from rlbench.system.half_precision import emulation_reason
    from rlbench.training.loop import TrainingRuns

    selected = str(target := select_device(device))
    if graph is None:
        graph = target.type == "cuda" and can_record(CudaGraphs(), target)
    if config.bf16 and (reason := emulation_reason(selected)):
        note(f"warning: {reason}; training is faster without --bf16")
    return TrainingRuns(
        out,
        config,
        selected,
        graph,
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

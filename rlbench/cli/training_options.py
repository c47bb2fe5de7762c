"""Options of the commands that train."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Budgets
from rlbench.cli.completion import complete_names

TRAINING, QUEUE = "Training", "Queue"  # titles of groups of options

DEFAULT_FRAMES, DEFAULT_CROP = 12_000, 128  # those of TrainingConfig
QUICK_FRAMES = 600
DEFAULT_SPP = Budgets(())  # those of the method

Frames = Annotated[
    int, typer.Option(min=1, help="crops to train on, per method", rich_help_panel=TRAINING)
]
TrainFrames = Annotated[
    int | None,
    typer.Option(
        min=1,
        help=f"crops to train on, per method; default: {DEFAULT_FRAMES}, or {QUICK_FRAMES} with "
        "--quick",
        rich_help_panel=TRAINING,
    ),
]
Quick = Annotated[
    bool,
    typer.Option(
        "--quick",
        help="try a training: on procedural clips, which need no rendering, not for results",
        rich_help_panel=options.CLIPS,
    ),
]
Batch = Annotated[
    int, typer.Option(min=1, help="crops that advance together", rich_help_panel=TRAINING)
]
Crop = Annotated[
    int, typer.Option(min=16, help="side of a crop in pixels", rich_help_panel=TRAINING)
]
TrainSpp = Annotated[
    Budgets,
    typer.Option(
        parser=arguments.parse_train_spp,
        metavar="SPP",
        show_default=False,
        help="training budgets such as 4 or 0.5,1,2; default: those of the method",
        rich_help_panel=TRAINING,
    ),
]
Bf16 = Annotated[
    bool,
    typer.Option("--bf16", help="run the forward pass in bfloat16", rich_help_panel=TRAINING),
]
MaxGradNorm = Annotated[
    float,
    typer.Option(
        parser=arguments.parse_positive,
        metavar="NORM",
        help="longer gradients are scaled down to this L2 norm",
        rich_help_panel=TRAINING,
    ),
]
Seed = Annotated[
    int, typer.Option(help="of weights, sequences and budgets", rich_help_panel=TRAINING)
]
EvalInterval = Annotated[
    int,
    typer.Option(
        min=1,
        metavar="FRAMES",
        help="crops between two validations, each of which writes a checkpoint",
        rich_help_panel=TRAINING,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|RUN",
        help="first weights of new runs: a weights file, or a finished run in --out such as "
        "ours/A2; tensors of equal name and shape are taken",
        rich_help_panel=TRAINING,
    ),
]
Queue = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="run the trainings that a TOML file lists, on free processors; the same command "
        "resumes them",
        rich_help_panel=QUEUE,
    ),
]
Status = Annotated[
    bool,
    typer.Option(
        "--status", help="show how far the trainings of --queue are", rich_help_panel=QUEUE
    ),
]
Pause = Annotated[
    bool | None,
    typer.Option(
        "--pause/--unpause",
        help="stop the processes of the queue that runs in --out, or let them continue",
        rich_help_panel=QUEUE,
    ),
]
Minutes = Annotated[
    float | None,
    typer.Option(
        parser=arguments.parse_positive,
        metavar="MINUTES",
        help="stop each training after this time, rendering of clips included, and a queue as a "
        "whole; the same command resumes it",
        rich_help_panel=TRAINING,
    ),
]
AllowConfigChange = Annotated[
    bool,
    typer.Option(
        "--allow-config-change",
        help="resume a checkpoint that has another config; the model card records the change",
        rich_help_panel=TRAINING,
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="PRESETS",
        help="clips to train on, a or a,b; default: train, or mini with --holdout",
        autocompletion=complete_names("presets"),
        rich_help_panel=options.CLIPS,
    ),
]
Clips = Annotated[
    list[str] | None,
    typer.Option(
        "--clips",
        metavar="FOLDERS",
        help="clips of your own to train on, folders or patterns a,b, alone or mixed with "
        "--preset; can be repeated",
        rich_help_panel=options.CLIPS,
    ),
]
Mix = Annotated[
    float | None,
    typer.Option(
        parser=arguments.parse_share,
        metavar="SHARE",
        help="share of the crops from --clips where --preset is given too; default: 0.5",
        rich_help_panel=options.CLIPS,
    ),
]
Validate = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]SET",
        help="clips to validate on: folders, or presets for decisions such as development, a,b; "
        "each is a set with a curve; default: some of those to train on",
        rich_help_panel=options.CLIPS,
    ),
]
Keep = Annotated[
    str,
    typer.Option(
        parser=arguments.parse_keep,
        metavar="last|best|best:SET",
        help="which averaged weights to save: the last ones, or those of the best validation, by "
        "the mean over the sets or by one of them",
        rich_help_panel=TRAINING,
    ),
]
Holdout = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE",
        help="train on the test scenes of the preset except this one",
        rich_help_panel=options.CLIPS,
    ),
]
RunsFolder = Annotated[
    Path,
    typer.Option(
        file_okay=False,
        metavar="FOLDER",
        help="folder of weights, checkpoints and logs",
        rich_help_panel=options.OUTPUT,
    ),
]

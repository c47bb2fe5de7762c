"""Options that several commands share, each declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli import arguments
from rlbench.cli.arguments import Budgets, Seeds, WeightsChoice
from rlbench.cli.completion import complete_methods, complete_names

METHODS, CLIPS = "Methods", "Clips"  # titles of groups of options
MEASUREMENT, EXECUTION, OUTPUT = "Measurement", "Execution", "Output"
RENDERING = "Rendering"

DEFAULT_SPP = Budgets((0.5, 1.0, 2.0, 4.0))
DEFAULT_IMAGE_SPP = Budgets((1.0,))
DEFAULT_SEEDS = Seeds((0,))

# methods
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--methods",
        "-m",
        metavar="NAMES",
        help="names a,b; all; family/*; all/*; can be repeated, and -m can be left out",
        autocompletion=complete_methods,
        rich_help_panel=METHODS,
    ),
]
RowMethods = Annotated[
    list[str] | None,
    typer.Option(
        "--methods",
        "-m",
        metavar="NAMES",
        help="names a,b of rows in the results; default: all",
        autocompletion=complete_methods,
        rich_help_panel=METHODS,
    ),
]
Plugins = Annotated[
    list[Path] | None,
    typer.Option(
        "--plugin",
        metavar="FILE",
        help="a Python file with FAMILY or METHODS; can be repeated",
        rich_help_panel=METHODS,
    ),
]
Weights = Annotated[
    WeightsChoice | None,
    typer.Option(
        parser=arguments.parse_weights,
        metavar="[NAME=]FILE",
        help="trained weights, for rows METHOD@NAME; or random; default: the shipped weights",
        rich_help_panel=METHODS,
    ),
]
Bf16 = Annotated[
    bool,
    typer.Option(
        "--bf16", help="run networks in bfloat16, for rows METHOD@bf16", rich_help_panel=METHODS
    ),
]
Backend = Annotated[
    Literal["eager", "openvino", "compile", "auto"],
    typer.Option(
        help="what runs networks: PyTorch, OpenVINO, torch.compile, or OpenVINO where it is "
        "installed; for rows METHOD@openvino",
        rich_help_panel=METHODS,
    ),
]

# clips
Scenes = Annotated[
    list[str] | None,
    typer.Option(
        "--scenes",
        metavar="NAMES",
        help="scenes or clips a,b; default: all",
        autocompletion=complete_names("scenes"),
        rich_help_panel=CLIPS,
    ),
]
Preset = Annotated[
    str,
    typer.Option(
        metavar="PRESET",
        help="size and length of the clips: see rlbench list presets",
        autocompletion=complete_names("presets"),
        rich_help_panel=CLIPS,
    ),
]
Takes = Annotated[
    Literal["main", "all"] | None,
    typer.Option(help="takes of each scene; default: as in the preset", rich_help_panel=CLIPS),
]
Clips = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FOLDER",
        help="a clip, or a folder of clips, instead of a preset; can be repeated",
        rich_help_panel=CLIPS,
    ),
]
SceneSeeds = Annotated[
    Seeds | None,
    typer.Option(
        parser=arguments.parse_seeds,
        metavar="SEEDS",
        help="seeds of generated scenes, 0:40 or 3,7; default: as in the preset",
        rich_help_panel=CLIPS,
    ),
]

RowScenes = Annotated[
    list[str] | None,
    typer.Option(
        "--scenes",
        metavar="NAMES",
        help="scenes or clips a,b of the results; default: all",
        autocompletion=complete_names("scenes"),
        rich_help_panel=CLIPS,
    ),
]

# measurement
RowBudgets = Annotated[
    Budgets | None,
    typer.Option(
        "--spp",
        parser=arguments.parse_budgets,
        metavar="SPP",
        help="budgets of the results in samples per pixel; default: all",
        rich_help_panel=MEASUREMENT,
    ),
]
ShownBudgets = Annotated[
    Budgets | None,
    typer.Option(
        "--spp",
        parser=arguments.parse_budgets,
        metavar="SPP",
        help="budgets whose images are shown; default: the one nearest to 1 spp",
        rich_help_panel=MEASUREMENT,
    ),
]
Metric = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="the score that decides, as in the results",
        autocompletion=complete_names("metrics"),
        rich_help_panel=MEASUREMENT,
    ),
]
RowDevice = Annotated[
    str,
    typer.Option(
        "--device",
        metavar="NAME",
        help="device whose rows count, if the results have several",
        rich_help_panel=MEASUREMENT,
    ),
]
Draws = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="number of sample orders: --draws 3 is --seed 0,1,2",
        rich_help_panel=MEASUREMENT,
    ),
]
Spp = Annotated[
    Budgets,
    typer.Option(
        parser=arguments.parse_budgets,
        metavar="SPP",
        show_default=False,
        help="budgets in samples per pixel; default: 0.5,1,2,4",
        rich_help_panel=MEASUREMENT,
    ),
]
Cost = Annotated[
    str,
    typer.Option(
        metavar="COST",
        help="time of a sample: measured, paper-2080ti, or a TOML file",
        autocompletion=complete_names("profiles"),
        rich_help_panel=MEASUREMENT,
    ),
]
LimitFrames = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="measure only the first frames of each clip, for a trial run",
        rich_help_panel=MEASUREMENT,
    ),
]

# execution
Device = Annotated[
    str,
    typer.Option(
        metavar="DEVICE", help="auto, cpu, cuda, or a torch device", rich_help_panel=EXECUTION
    ),
]
Engine = Annotated[
    Literal["local", "ray"],
    typer.Option(help="ray works on many frames or cells in parallel", rich_help_panel=EXECUTION),
]
RayAddress = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="of a running Ray cluster, auto or host:port; default: start Ray here",
        rich_help_panel=EXECUTION,
    ),
]

# output
Json = Annotated[
    bool,
    typer.Option("--json", help="print JSON, for scripts", rich_help_panel=OUTPUT),
]
Results = Annotated[
    Path,
    typer.Option(
        file_okay=False,
        metavar="FOLDER",
        help="folder of the results table",
        rich_help_panel=OUTPUT,
    ),
]
ResultsOut = Annotated[
    Path,
    typer.Option(
        file_okay=False,
        metavar="FOLDER",
        help="results folder; new rows are added to it",
        rich_help_panel=OUTPUT,
    ),
]

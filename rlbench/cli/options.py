"""Options: how one is declared, those that several commands share, and what the shell completes.

A command lists its options in the order of their importance: `-h` shows the first ones, and
`--help-all` shows them all, in the groups below.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer

from rlbench.benchmark import run_options
from rlbench.cli import arguments
from rlbench.cli.arguments import Budgets, PixelSize, Seeds, WeightsChoice
from rlbench.training.task import TrainingConfig

METHODS, CLIPS, MEASUREMENT = "Methods", "Clips", "Measurement"  # titles of groups
TRAINING, EXECUTION, OUTPUT, OTHER = "Training", "Execution", "Output", "Options"
GROUPS = (METHODS, CLIPS, MEASUREMENT, TRAINING, EXECUTION, OUTPUT, OTHER)  # in the help

DEFAULT_SPP = Budgets(run_options.DEFAULT_SPP)
DEFAULT_SEEDS = Seeds((0,))
DEFAULT_TRAIN_SPP = Budgets(())  # those of the method
DEFAULT_FRAMES = TrainingConfig.frames
SHIPPED = WeightsChoice()

Complete = Callable[[str], list[str]]
T = TypeVar("T")


def fill(record: Callable[..., T], options: Mapping[str, Any], **others: Any) -> T:
    """A record whose fields are options of a command (its `locals()`), but for `others`."""
    names = inspect.signature(record).parameters
    return record(**{name: options[name] for name in names if name in options} | others)


def option(
    group: str | None,
    text: str,
    *names: str,
    value: str | None = None,
    parse: Callable[[str], Any] | None = None,
    complete: Complete | None = None,
    **more: Any,
) -> Any:
    """An option in a group of the help; `value` is what the help shows in place of a value.

    Without `names` it is called as the parameter.
    """
    return typer.Option(
        *names,
        help=text,
        metavar=value,
        parser=parse,
        autocompletion=complete,
        rich_help_panel=group,
        **more,
    )


def number(group: str | None, text: str, value: str, *names: str) -> Any:
    """An option whose value is a number above 0."""
    return option(group, text, *names, value=value, parse=arguments.parse_positive)


def flag(group: str | None, name: str, text: str) -> Any:
    """An option without a value."""
    return option(group, text, name)


def folder(text: str, *names: str) -> Any:
    """An option that names a folder to read or write."""
    return option(OUTPUT, text, *names, value="FOLDER", file_okay=False)


def file(text: str, group: str | None = OUTPUT) -> Any:
    """An option that names a file to write."""
    return option(group, text, value="FILE", dir_okay=False)


def complete_names(kind: str, more: Iterable[str] = ()) -> Complete:
    """A completer of the names of one kind, as in `rlbench list KIND`, and of `more` words.

    In a list a,b it completes the last name. Nothing heavy is imported.
    """

    def complete(incomplete: str) -> list[str]:
        from rlbench import registry
        from rlbench.benchmark.listing import list_installed

        if kind in ("scenes", "reports", "metrics"):
            names = registry.list_plugins(kind)
        else:
            names = [row["name"] for row in list_installed(kind)[kind]]
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in (*names, *more) if name.startswith(last)]

    return complete


complete_methods = complete_names("methods", ("all",))


def names_of_methods(text: str, value: str = "NAMES") -> Any:
    """The option --methods."""
    return option(METHODS, text, "--methods", "-m", value=value, complete=complete_methods)


def names_of_scenes(text: str) -> Any:
    """The option --scenes."""
    return option(CLIPS, text, "--scenes", value="NAMES", complete=complete_names("scenes"))


def budgets(text: str, *, has_default: bool = True) -> Any:
    """The option --spp, a list of budgets."""
    parse = arguments.parse_budgets
    return option(
        MEASUREMENT, text, "--spp", value="SPP", parse=parse, show_default=not has_default
    )


# methods
Methods = Annotated[
    list[str] | None,
    names_of_methods("names a,b; all; family/*; all/*; can be repeated, and -m can be left out"),
]
RowMethods = Annotated[
    list[str] | None, names_of_methods("names a,b of rows in the results; default: all")
]
Plugins = Annotated[
    list[Path] | None,
    option(
        METHODS,
        "a Python file with FAMILY or METHODS, or with METRIC or METRICS; can be repeated",
        "--plugin",
        value="FILE",
    ),
]
Weights = Annotated[
    WeightsChoice,
    option(
        METHODS,
        "trained weights: METHOD=FILE of one method, FILE of all, NAME=FILE for rows METHOD@NAME; "
        "or random; default: the shipped weights",
        value="[NAME=]FILE",
        parse=arguments.parse_weights,
        show_default=False,
    ),
]
Half = Annotated[
    bool,
    flag(METHODS, "--half", "run networks in half precision, for rows METHOD@half"),
]
BackendName = Literal["eager", "openvino", "compile", "graph", "fused", "auto"]
Backend = Annotated[
    BackendName,
    option(
        METHODS,
        "what runs networks: PyTorch, OpenVINO, torch.compile, CUDA graphs of whole stages, the "
        "same compiled first, or OpenVINO where it is installed; for rows METHOD@openvino",
    ),
]

# clips
Scenes = Annotated[list[str] | None, names_of_scenes("scenes or clips a,b; default: all")]
RowScenes = Annotated[
    list[str] | None, names_of_scenes("scenes or clips a,b of the results; default: all")
]
Preset = Annotated[
    str,
    option(
        CLIPS,
        "size and length of the clips: see rlbench list presets",
        value="PRESET",
        complete=complete_names("presets"),
    ),
]
Size = Annotated[
    PixelSize | None,
    option(
        CLIPS,
        "of the preset's clips in pixels, for rows of preset NAME-WIDTHxHEIGHT; default: its own",
        value="WIDTHxHEIGHT",
        parse=arguments.parse_size,
    ),
]
Takes = Annotated[
    Literal["main", "all"] | None,
    option(CLIPS, "takes of each scene; default: as in the preset"),
]
Clips = Annotated[
    list[Path] | None,
    option(
        CLIPS, "a clip, or a folder of clips, instead of a preset; can be repeated", value="FOLDER"
    ),
]
SceneSeeds = Annotated[
    Seeds | None,
    option(
        CLIPS,
        "seeds of generated scenes, 0:40 or 3,7; default: as in the preset",
        value="SEEDS",
        parse=arguments.parse_seeds,
    ),
]

# measurement
Spp = Annotated[Budgets, budgets("budgets in samples per pixel; default: 0.5,1,2,4")]
RowBudgets = Annotated[
    Budgets | None, budgets("budgets of the results in samples per pixel; default: all")
]
ShownBudgets = Annotated[
    Budgets | None, budgets("budgets whose images are shown; default: one of them")
]
Metric = Annotated[
    str,
    option(
        MEASUREMENT,
        "the score that decides, as in the results",
        value="NAME",
        complete=complete_names("metrics"),
    ),
]
RowDevice = Annotated[
    str,
    option(
        MEASUREMENT,
        "device whose rows count, if the results have several",
        "--device",
        value="NAME",
    ),
]
Cost = Annotated[
    str,
    option(
        MEASUREMENT,
        "time of a sample: measured, paper-2080ti, or a TOML file",
        value="COST",
        complete=complete_names("profiles"),
    ),
]
GbufferMs = Annotated[
    float | None,
    option(
        MEASUREMENT,
        "time of your G-buffer, for methods that read one; default: as many samples as in the "
        "results",
        "--gbuffer-ms",
        value="MS",
        parse=arguments.parse_time,
    ),
]
Repeats = Annotated[
    int,
    option(
        MEASUREMENT,
        "fewest timed frames of a row; more are timed until the median is steady",
        min=1,
    ),
]
LimitFrames = Annotated[
    int | None,
    option(
        MEASUREMENT,
        "measure only the first frames of each clip, for a trial run, and render no others",
        min=1,
    ),
]

# training
Frames = Annotated[
    int | None,
    option(
        TRAINING,
        f"crops to train on, per method; default: {DEFAULT_FRAMES}, or 600 with train --quick",
        min=1,
    ),
]
Batch = Annotated[int, option(TRAINING, "crops that advance together", min=1)]
Crop = Annotated[int, option(TRAINING, "side of a crop in pixels", min=16)]
TrainSpp = Annotated[
    Budgets,
    option(
        TRAINING,
        "training budgets such as 4 or 0.5,1,2; default: those of the method",
        value="SPP",
        parse=arguments.parse_train_spp,
        show_default=False,
    ),
]
TrainBf16 = Annotated[bool, flag(TRAINING, "--bf16", "run the forward pass in bfloat16")]
MaxGradNorm = Annotated[
    float,
    number(TRAINING, "longer gradients are scaled down to this L2 norm", "NORM"),
]
TrainSeed = Annotated[int, option(TRAINING, "of weights, sequences and budgets", "--seed")]
Minutes = Annotated[
    float | None,
    number(
        TRAINING,
        "stop each training after this time, rendering of clips included, and a queue as a "
        "whole; the same command resumes it",
        "MINUTES",
    ),
]
AllowConfigChange = Annotated[
    bool,
    flag(
        TRAINING,
        "--allow-config-change",
        "resume a checkpoint that has another config; the model card records the change",
    ),
]

# execution
Device = Annotated[str, option(EXECUTION, "auto, cpu, cuda, or a torch device", value="DEVICE")]
Engine = Annotated[
    str,
    option(
        EXECUTION,
        "local, or ray, which works on many frames or cells in parallel: ray starts Ray here, "
        "ray=auto or ray=HOST:PORT joins a cluster",
        value="ENGINE",
    ),
]

# output
Json = Annotated[bool, flag(OUTPUT, "--json", "print JSON, for scripts")]
Results = Annotated[Path, folder("folder of the results table")]
RunFolder = Annotated[
    Path, typer.Argument(metavar="RESULTS", help="folder of rlbench run", file_okay=False)
]

"""The command decide: which method gives the least error in a frame time."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.json_output import as_json_text
from rlbench.cli.plugins import load_plugins
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["decide", "select_by_inputs", "select_scenes"]

NAME = "frame-time"  # of the decision, among the entry points


def decide(
    sample_ms: Annotated[
        float,
        typer.Option(
            "--sample-ms",
            parser=arguments.parse_positive,
            metavar="MS",
            help="your renderer's time for one sample of every pixel",
            rich_help_panel=options.MEASUREMENT,
        ),
    ],
    frame_ms: Annotated[
        float,
        typer.Option(
            "--frame-ms",
            parser=arguments.parse_positive,
            metavar="MS",
            help="the deadline: 16.7 for 60 frames a second",
            rich_help_panel=options.MEASUREMENT,
        ),
    ],
    methods: options.RowMethods = None,
    plugin: options.Plugins = None,
    needs: Annotated[
        list[str] | None,
        typer.Option(
            "--needs",
            metavar="NAMES",
            help="consider only methods that need none but these G-buffer channels a,b",
            rich_help_panel=options.METHODS,
        ),
    ] = None,
    scenes: options.RowScenes = None,
    metric: options.Metric = "psnr",
    device: options.RowDevice = "",
    sample_device: Annotated[
        str,
        typer.Option(
            "--sample-device",
            metavar="NAME",
            help="device of --sample-ms; a warning says if methods were timed on another",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = "",
    results: options.Results = Path("results"),
    as_json: options.Json = False,
) -> None:
    """Name the method with the least error in a frame time.

    Reads the results table alone: the expected score with its interval, the runner-up, and the
    cost of a sample and the deadline at which another method wins.

    Examples:

    \b
      rlbench decide --sample-ms 4.2 --frame-ms 16.7
      rlbench decide --sample-ms 4.2 --frame-ms 33.3 --scenes city,hall --needs albedo,normal
      rlbench decide --sample-ms 26.3 --frame-ms 100 --results results/gpu --json
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.benchmark.results import read
    from rlbench.cli.reports import select_rows

    rows = read(results)
    if names := arguments.split_names(methods):
        rows = select_rows(rows, names, results)
    if names := arguments.split_names(scenes):
        rows = select_scenes(rows, names, results)
    left_out: list[str] = []
    if needs is not None:
        rows, left_out = select_by_inputs(rows, arguments.split_names(needs))
    module = registry.load_or_explain("decisions", NAME)
    decision = module.decide(rows, sample_ms, frame_ms, metric, device, left_out)
    typer.echo(as_json_text(decision) if as_json else module.decision_text(decision, sample_device))


def select_scenes(rows: pd.DataFrame, names: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of scenes and clips with these names. Raises OptionError for an unknown name."""
    available = {*rows["scene"], *rows["clip"]}
    if unknown := [name for name in names if name not in available]:
        problem = f"--scenes {','.join(unknown)}: {results} has no rows of it"
        raise OptionError(unknown_name(problem, unknown[0], sorted(available)))
    return rows[rows["scene"].isin(names) | rows["clip"].isin(names)]


def select_by_inputs(
    rows: pd.DataFrame, channels: Collection[str]
) -> tuple[pd.DataFrame, list[str]]:
    """The rows of methods that declare no other input than `channels`, and why others are left out.

    Raises OptionError for an unknown channel, and if no method is left.
    """
    from rlbench.clips.header import BUFFER_CHANNELS

    if unknown := [name for name in channels if name not in BUFFER_CHANNELS]:
        problem = f"--needs {','.join(unknown)}: no such G-buffer channel"
        raise OptionError(unknown_name(problem, unknown[0], BUFFER_CHANNELS))
    reasons = {method: _lacking(method, channels) for method in sorted(set(rows["method"]))}
    left_out = [f"{method} is left out: {reason}" for method, reason in reasons.items() if reason]
    if len(left_out) == len(reasons):
        raise OptionError(f"--needs {','.join(channels)} leaves no method: {'; '.join(left_out)}")
    return rows[rows["method"].map(reasons) == ""], left_out


def _lacking(method: str, channels: Collection[str]) -> str:
    """Why a method of the results cannot do with these channels alone; empty if it can."""
    from rlbench import registry
    from rlbench.benchmark.results import RowName

    try:
        inputs = registry.get_variant(RowName.parse(method).method).traits.inputs
    except registry.PluginError:
        return "it is not installed, so its inputs are not known; name its file with --plugin"
    return f"it needs {', '.join(missing)}" if (missing := sorted(inputs - set(channels))) else ""

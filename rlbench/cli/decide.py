"""The command decide: which method gives the least error in a frame time."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import parse_positive, split_names
from rlbench.cli.json_output import as_json_text
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import MEASUREMENT, METHODS, flag, option
from rlbench.cli.selection import read_rows
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["decide"]


def decide(
    sample_ms: Annotated[
        float,
        option(
            MEASUREMENT,
            "your renderer's time for one sample of every pixel",
            value="MS",
            parse=parse_positive,
        ),
    ],
    frame_ms: Annotated[
        float,
        option(
            MEASUREMENT,
            "the deadline: 16.7 for 60 frames a second",
            value="MS",
            parse=parse_positive,
        ),
    ],
    methods: options.RowMethods = None,
    scenes: options.RowScenes = None,
    needs: Annotated[
        list[str] | None,
        option(
            METHODS,
            "consider only methods that need none but these G-buffer channels a,b",
            value="NAMES",
        ),
    ] = None,
    metric: options.Metric = "psnr",
    results: options.Results = Path("results"),
    as_json: options.Json = False,
    plugin: options.Plugins = None,
    device: options.RowDevice = "",
    allow_unreliable: Annotated[
        bool,
        flag(
            MEASUREMENT,
            "--allow-unreliable",
            "also use times that the clock rejected, with a mark",
        ),
    ] = False,
    sample_device: Annotated[
        str,
        option(
            MEASUREMENT,
            "device of --sample-ms; a warning says if methods were timed on another",
            value="NAME",
        ),
    ] = "",
) -> None:
    """Name the method with the least error in a frame time.

    Reads the results table alone: the expected score with its interval, the runner-up, and the
    cost of a sample and the deadline at which another method wins. Times that the clock rejected
    are not used; the exit code is 1 if all are of this kind.

    Examples:

    \b
      rlbench decide --sample-ms 4.2 --frame-ms 16.7
      rlbench decide --sample-ms 4.2 --frame-ms 33.3 --scenes city,hall --needs albedo,normal
      rlbench decide --sample-ms 26.3 --frame-ms 100 --results results/gpu --json
    """
    load_plugins(plugin)
    import reports.decide

    rows, left_out = read_rows(results, methods, scenes), list[str]()
    if needs is not None:
        rows, left_out = _select_by_inputs(rows, split_names(needs))
    decision = reports.decide.decide(
        rows, sample_ms, frame_ms, metric, device, left_out, allow_unreliable
    )
    text = reports.decide.decision_text
    typer.echo(as_json_text(decision) if as_json else text(decision, sample_device))


def _select_by_inputs(
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

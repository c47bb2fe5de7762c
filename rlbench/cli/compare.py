"""The command compare: does one method lead another, and how sure is that."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench import api
from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.json_output import as_json_text
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import names_of_methods
from rlbench.cli.selection import read_rows


def compare(
    methods: Annotated[
        list[str] | None,
        names_of_methods("names of two rows in the results; -m can be left out", value="A,B"),
    ] = None,
    scenes: options.RowScenes = None,
    spp: options.RowBudgets = None,
    metric: options.Metric = "psnr",
    device: options.RowDevice = "",
    results: options.Results = Path("results"),
    plugin: options.Plugins = None,
    as_json: options.Json = False,
) -> None:
    """Say whether one method leads another, and how sure that is.

    Reads the results table alone. Scores are paired by frame, scenes are the units of the
    interval, and a tie is an interval within +-0.1 dB.

    Examples:

    \b
      rlbench compare -m ours,accumulate/contrast
      rlbench compare -m ours,oidn/tuned --spp 1,4 --scenes city,hall
      rlbench compare -m ours,ours/A1 --metric relmse --results results/unseen --json
    """
    names = split_names(methods)
    if len(names) != 2:
        raise typer.BadParameter(f"name two rows, for example -m ours,oidn; {len(names)} are named")
    load_plugins(plugin)
    from reports.compare import comparison_text

    rows = read_rows(results, names, scenes, spp)
    first, second = names
    found = api.compare(first, second, rows, folder=results, metric=metric, device=device)
    typer.echo(as_json_text(found) if as_json else comparison_text(found))

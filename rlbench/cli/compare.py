"""The command compare: does one method lead another, and how sure is that."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.completion import complete_methods
from rlbench.cli.decide import select_scenes
from rlbench.cli.json_output import as_json_text
from rlbench.cli.reports import select_budgets, select_rows

__all__ = ["compare"]

NAME = "paired"  # of the comparison, among the entry points


def compare(
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--methods",
            "-m",
            metavar="A,B",
            help="names of two rows in the results; -m can be left out",
            autocompletion=complete_methods,
            rich_help_panel=options.METHODS,
        ),
    ] = None,
    scenes: options.RowScenes = None,
    spp: options.RowBudgets = None,
    metric: options.Metric = "psnr",
    device: options.RowDevice = "",
    results: options.Results = Path("results"),
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
    from rlbench import registry
    from rlbench.benchmark.results import read

    names = arguments.split_names(methods)
    if len(names) != 2:
        raise typer.BadParameter(f"name two rows, for example -m ours,oidn; {len(names)} are named")
    first, second = names
    rows = select_rows(read(results), names, results)
    if scene_names := arguments.split_names(scenes):
        rows = select_scenes(rows, scene_names, results)
    if spp:
        rows = select_budgets(rows, spp, results)
    module = registry.load_or_explain("comparisons", NAME)
    comparison = module.compare(rows, first, second, metric, device)
    typer.echo(as_json_text(comparison) if as_json else module.comparison_text(comparison))

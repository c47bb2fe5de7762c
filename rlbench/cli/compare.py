"""The command compare: does one method lead another, and how sure is that."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.decide import as_json_text, select_scenes
from rlbench.cli.reports import select_budgets, select_rows

__all__ = ["compare"]

NAME = "paired"  # of the comparison, among the entry points


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="name of a row in the results")],
    second: Annotated[str, typer.Argument(metavar="B", help="name of another row")],
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
      rlbench compare ours accumulate/contrast
      rlbench compare ours oidn/tuned --spp 1,4 --scenes city,hall
      rlbench compare ours ours/A1 --metric relmse --results results/unseen --json
    """
    from rlbench import registry
    from rlbench.benchmark.results import read

    rows = select_rows(read(results), [first, second], results)
    if names := arguments.split_names(scenes):
        rows = select_scenes(rows, names, results)
    if spp:
        rows = select_budgets(rows, spp, results)
    module = registry.load_or_explain("comparisons", NAME)
    comparison = module.compare(rows, first, second, metric, device)
    typer.echo(as_json_text(comparison) if as_json else module.comparison_text(comparison))

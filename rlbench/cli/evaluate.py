"""The command evaluate: score kept images again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import MEASUREMENT, folder, option


def evaluate(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS", file_okay=False, help="results folder of rlbench run --keep-images"
        ),
    ] = Path("results"),
    metrics: Annotated[
        list[str] | None,
        option(
            MEASUREMENT,
            "metrics a,b; can be repeated; default: psnr; rlbench list metrics has all",
            value="NAMES",
        ),
    ] = None,
    convention: Annotated[
        list[str] | None,
        option(
            MEASUREMENT,
            "conventions a,b of metrics that take one; default: srgb; can be repeated",
            value="NAMES",
        ),
    ] = None,
    methods: options.RowMethods = None,
    plugin: options.Plugins = None,
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    takes: options.Takes = None,
    clips: options.Clips = None,
    out: Annotated[
        Path | None, folder("results folder to write to; default: RESULTS/evaluated")
    ] = None,
) -> None:
    """Score stored images again, without running a method.

    The clips must be those that the images show. Rows have the format of a run, so reports read
    them: rlbench report --results RESULTS/evaluated. Scores that are there already stay. The exit
    code is 1 if a metric failed; the last lines say why.

    Examples:

    \b
      rlbench evaluate results --metrics psnr --convention srgb,hable,linear
      rlbench evaluate results --metrics flip,hdr_flip --scenes city -m ours,ntas
      rlbench evaluate mine --metrics mymetric --plugin mymetric.py --clips my_renders/
    """
    load_plugins(plugin)
    from rlbench.benchmark import evaluation
    from rlbench.benchmark.cell_images import find_kept_cells, image_pools, list_images
    from rlbench.benchmark.evaluation import select_metrics
    from rlbench.benchmark.planning import select_clips
    from rlbench.cli import console
    from rlbench.system.paths import check_no_link, check_writable

    selected = select_metrics(split_names(metrics) or ["psnr"], split_names(convention))
    target = out or check_no_link(results, results / "evaluated")
    check_writable(target)
    pools, longest = image_pools(results), max(map(len, list_images(results)))
    sources = select_clips(
        clips, split_names(scenes), preset, takes, pool_kinds=pools, limit_frames=longest
    )
    cells = find_kept_cells(results, sources, split_names(methods))
    with console.counting("scoring images", len(cells)) as advance:
        summary = evaluation.evaluate(results, cells, selected, target, lambda kept: advance())
    names = ", ".join(each.name for each in selected)
    typer.echo(
        f"{names}: {summary.scored} scored, {summary.cached} already in the results; "
        f"results are in {target}"
    )
    for failure in summary.failures:
        typer.echo(f"failed: {failure}", err=True)
    raise typer.Exit(1 if summary.failures else 0)

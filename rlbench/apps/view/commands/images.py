"""The command images: outputs of methods on one frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.benchmark.run_options import RunOptions
from rlbench.cli import options
from rlbench.cli.arguments import Budgets, split_names
from rlbench.cli.methods import (
    expand_methods,
    load_rows,
    require_methods,
    warn_without_networks,
)
from rlbench.cli.options import CLIPS, MEASUREMENT, fill, folder, option

ONE_SPP = Budgets((1.0,))


def images(
    context: typer.Context,
    methods: options.Methods = None,
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    clips: options.Clips = None,
    spp: Annotated[Budgets, options.budgets("budgets in samples per pixel; default: 1")] = ONE_SPP,
    frame: Annotated[int, option(CLIPS, "index of the frame; -1: the last")] = -1,
    out: Annotated[Path, folder("folder to write to")] = Path("images"),
    plugin: options.Plugins = None,
    weights: options.Weights = options.SHIPPED,
    half: options.Half = False,
    takes: options.Takes = None,
    seed: Annotated[
        int, option(MEASUREMENT, "seed of the sample order and of rounding", min=0)
    ] = 0,
    device: options.Device = "auto",
) -> None:
    """Write images of one frame: PNG, EXR, and a sheet.

    PNG files are clipped sRGB, EXR files are linear. The sheet shows images, errors and samples per
    pixel of all methods. Pixels that are not finite are magenta. A method that an error stopped is
    named with its reason, and the exit code is then 1.

    Examples:

    \b
      rlbench images -m ours,ntas,mean --scenes city
      rlbench images -m ours,ours/A2 --preset standard --takes main --spp 0.1,1 --frame 5
    """
    load_rows(context, plugin, require_methods(methods))
    names = expand_methods(methods)  # before torch
    chosen = weights.for_methods(names)
    from rlbench.benchmark.frame_images import ImagesError, write_images
    from rlbench.benchmark.planning import plan_run
    from rlbench.cli import console

    warn_without_networks(names, half, chosen)
    plan = plan_run(
        fill(
            RunOptions,
            locals(),
            methods=names,
            scenes=split_names(scenes),
            seeds=(seed,),
            weights=chosen.file,
            weights_label=chosen.label,
            weights_for=chosen.methods,
        )
    )
    with console.measuring(plan) as bar:
        sheets = list(write_images(plan, frame, out, bar.on_cell))
    missing = [each for sheet in sheets for each in sheet.missing.items()]
    has_failed = any(sheet.failed for sheet in sheets)
    if not has_failed and not any(sheet.drawn for sheet in sheets):
        raise ImagesError("; ".join(dict.fromkeys(f"{name}: {why}" for name, why in missing)))
    for sheet in sheets:
        if sheet.drawn:
            typer.echo(sheet.file)
        for method, reason in sheet.missing.items():
            typer.echo(f"{sheet.file.name} lacks {method}: {reason}", err=True)
        for row, pixels in sheet.nonfinite.items():
            where = f"{pixels} pixels of {row}, drawn in magenta, are NaN or infinite"
            typer.echo(f"{sheet.file.name}: {where}; rlbench check finds out why", err=True)
    if has_failed:
        raise typer.Exit(1)

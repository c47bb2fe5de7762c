"""The command images: outputs of methods on one frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Budgets, WeightsChoice
from rlbench.cli.benchmark import warn_without_networks
from rlbench.cli.plugins import load_rows

__all__ = ["images"]


def images(
    context: typer.Context,
    methods: options.Methods = None,
    weights: options.Weights = None,
    bf16: options.Bf16 = False,
    plugin: options.Plugins = None,
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    takes: options.Takes = None,
    clips: options.Clips = None,
    frame: Annotated[
        int,
        typer.Option(help="index of the frame; -1: the last", rich_help_panel=options.CLIPS),
    ] = -1,
    spp: Annotated[
        Budgets,
        typer.Option(
            parser=arguments.parse_budgets,
            metavar="SPP",
            show_default=False,
            help="budgets in samples per pixel; default: 1",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = options.DEFAULT_IMAGE_SPP,
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            help="seed of the sample order and of rounding",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = 0,
    device: options.Device = "auto",
    out: Annotated[
        Path,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder to write to",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("images"),
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
    load_rows(context, plugin, arguments.require_methods(methods))
    names, chosen = arguments.expand_methods(methods), weights or WeightsChoice()  # before torch
    from rlbench import registry
    from rlbench.benchmark.api import check_precision, check_run, select_clips, select_device
    from rlbench.benchmark.frame_images import ImagesError, write_images
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console

    warn_without_networks(names, bf16, chosen)
    target = select_device(device)
    check_precision(names, bf16, device)
    check_run(names, spp, out, None if clips else preset, weights=chosen.file)
    pools = {registry.get_variant(name).traits.pool for name in names}
    scene_names = arguments.split_names(scenes)
    plan = RunPlan(
        methods=names,
        clips=select_clips(clips, scene_names, preset, takes, pool_kinds=pools),
        spp=spp,
        seeds=(seed,),
        device=target,
        weights=chosen.file,
        weights_label=chosen.label,
        bf16=bf16,
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

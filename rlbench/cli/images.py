"""The command that shows images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments
from rlbench.cli.clips import Clips, Preset, Scenes, Takes
from rlbench.cli.methods import Device, Methods, Plugins, load_plugins


def images(
    methods: Methods,
    scenes: Scenes = None,
    spp: Annotated[str, typer.Option(help="budgets, samples per pixel")] = "1",
    frame: Annotated[int, typer.Option(help="which; -1 is the last")] = -1,
    preset: Preset = "mini",
    takes: Takes = None,
    clips: Clips = None,
    seed: Annotated[int, typer.Option(min=0, help="of the order of sale and of rounding")] = 0,
    device: Device = "auto",
    weights: Annotated[
        str | None, typer.Option(help="NAME=FILE, a file, or random; default the shipped")
    ] = None,
    half: Annotated[bool, typer.Option("--half", help="networks in bfloat16")] = False,
    plugin: Plugins = None,
    out: Annotated[Path, typer.Option(help="folder to write to")] = Path("images"),
) -> None:
    """Write what methods show of one frame: PNG (clipped sRGB), EXR (linear), and a sheet of all.

    The sheet has images, errors and samples of each pixel. Pixels that are not finite are magenta.

    Examples:

      rlbench images -m ours,ntas,mean --scenes city

      rlbench images -m ours,ours/A2 --preset standard --takes main --spp 0.1,1 --frame 5
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.benchmark.frame_images import write_images
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.cli import console

    names = arguments.methods(methods)
    called, weights = arguments.weights(weights)
    kinds = {registry.get_variant(name).traits.pool for name in names}
    request = RunPlan(
        methods=names,
        clips=arguments.clips(clips, scenes, preset, kinds=kinds, takes=takes),
        target_spp=arguments.numbers("--spp", spp, float),
        seeds=(seed,),
        device=arguments.device(device),
        weights=weights,
        weights_label=called,
        bf16=half,
    )
    with console.progress(request) as bar:
        sheets = list(write_images(request, frame, out, bar.on_cell))
    for sheet in sheets:
        typer.echo(sheet.file)
        for method, why in sheet.missing.items():
            typer.echo(f"{sheet.file.name} is without {method}: {why}", err=True)

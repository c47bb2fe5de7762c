"""The command fingerprint: which buffer of the G-buffer a method leans on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.plugins import load_plugins

__all__ = ["fingerprint"]


def fingerprint(
    clips: Annotated[
        list[Path],
        typer.Option(
            exists=True,
            metavar="FOLDER",
            help="a clip, or a folder of clips; can be repeated",
            rich_help_panel=options.CLIPS,
        ),
    ],
    methods: options.Methods = None,
    spp: Annotated[
        float, typer.Option(min=0, help="samples per pixel", rich_help_panel=options.MEASUREMENT)
    ] = 1.0,
    limit_frames: Annotated[
        int,
        typer.Option(min=3, help="first frames of each clip", rich_help_panel=options.MEASUREMENT),
    ] = 8,
    plugin: options.Plugins = None,
    device: options.Device = "auto",
    out: Annotated[
        Path,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder of fingerprint.csv and fingerprint.json",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("results/fingerprint"),
) -> None:
    """Measure which buffers a method needs, in dB.

    Each buffer in turn is dropped (a constant, as rlbench import writes for a buffer that a source
    lacks), lagged by a frame, jittered by a pixel, or noised. A buffer whose loss is near 0 is not
    worth exporting for this method.

    Examples:

    \b
      rlbench fingerprint -m ours --clips clips/atrium
      rlbench fingerprint -m ours,svgf --clips clips/ --spp 4 --out results/fingerprint
    """
    load_plugins(plugin)
    names = arguments.expand_methods(methods)
    from rich.console import Console

    from rlbench.benchmark.api import select_device
    from rlbench.checks.fingerprint.run import fingerprint_method
    from rlbench.checks.fingerprint.tables import to_rich_table, write_losses
    from rlbench.clips.clip_folders import find_all_clips
    from rlbench.system.paths import check_writable

    target, folders = select_device(device), find_all_clips(clips)
    check_writable(out)
    losses = []
    for name in names:
        own = fingerprint_method(name, folders, spp, limit_frames, target)
        losses += own
        Console().print(to_rich_table(name, own) if own else f"{name} reads no buffer")
    for path in write_losses(losses, out):
        typer.echo(path)

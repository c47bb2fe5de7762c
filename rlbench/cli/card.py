"""The command card: README.md of a data set or of weights, for the Hugging Face hub."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli import options
from rlbench.cli.plugins import load_plugins

__all__ = ["card"]


def card(
    kind: Annotated[
        Literal["dataset", "weights"], typer.Argument(metavar="KIND", help="dataset or weights")
    ],
    name: Annotated[str, typer.Argument(metavar="NAME", help="a preset, or a method")],
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder for README.md, and for weights with their TOML card; default: print it",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    plugin: options.Plugins = None,
) -> None:
    """Write the card of a preset or of weights, for a model hub.

    The card is README.md as the Hugging Face hub reads it. That of a preset is made from the
    headers of the rendered clips, that of weights from their TOML card. Nothing is uploaded.

    Examples:

    \b
      rlbench card dataset mini --out mirror/
      rlbench card weights ours --out upload/ours
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.benchmark.hub_cards import dataset_card, weights_card
    from rlbench.cli.download import rendered_clips
    from rlbench.system import paths
    from rlbench.system.paths import check_writable
    from rlbench.weights import card_path

    if out:
        check_writable(out)
    text = dataset_card(name, rendered_clips(name)) if kind == "dataset" else weights_card(name)
    if out is None:
        typer.echo(text)
        return
    with paths.atomic_write(out / "README.md") as file:
        file.write_text(text, encoding="utf-8")
    if kind == "weights":
        weights = registry.shipped_weights(name)
        for source in (weights, card_path(weights)):
            with paths.atomic_write(out / source.name) as file:
                shutil.copyfile(source, file)
    for path in sorted(out.iterdir()):
        typer.echo(path)

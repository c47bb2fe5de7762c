"""The command that checks methods, and how methods are named on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import arguments

Methods = Annotated[
    list[str],
    typer.Option("--methods", "-m", help="names a,b; all; family/*; all/*; may be repeated"),
]
Plugins = Annotated[
    list[Path] | None, typer.Option("--plugin", help="a Python file with FAMILY or METHODS")
]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda, or a torch device")]


def load_plugins(plugins: list[Path] | None, listed: bool = False) -> None:
    """Make loose files known. Raises PluginError for a broken one, unless it is to be listed."""
    from rlbench import registry
    from rlbench.registry.discovery import plugin_file_error

    for path in plugins or []:
        registry.use_plugin(path)
        if not listed and (why := plugin_file_error(path)):
            raise registry.PluginError(f"--plugin {path}: {why}")


def check(
    methods: Annotated[list[str], typer.Argument(help="names a,b; family/*; all with variants")],
    plugin: Plugins = None,
    device: Device = "cpu",
) -> None:
    """Check that a method does what every method must, on a world whose truth is known.

    A tick list: what holds, what fails and what would do, and what does not apply (-). Weights are
    random, so nothing is said of quality. Exit code 1 if a claim fails.

    Examples:

      rlbench check ours

      rlbench check bright --plugin bright.py

      rlbench check all
    """
    load_plugins(plugin, listed="all" in arguments.split(methods))
    from rlbench.checks.conformance.run import check_methods as examine

    raise typer.Exit(0 if examine(arguments.split(methods), arguments.device(device)) else 1)

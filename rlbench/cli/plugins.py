"""The commands list and check, and the plugin files that many commands accept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli import arguments, options

__all__ = ["check", "list_", "load_plugins"]

Kind = Literal[
    "all", "methods", "metrics", "scenes", "reports", "pools", "presets", "profiles"
]  # those of `rlbench.benchmark.listing`


def load_plugins(files: list[Path] | None, allow_broken: bool = False) -> None:
    """Register plugin files. Raises PluginError for one that cannot be used, unless allowed."""
    from rlbench import registry
    from rlbench.registry.discovery import plugin_file_error

    for file in files or []:
        registry.use_plugin(file)
        if not allow_broken and (reason := plugin_file_error(file)):
            raise registry.PluginError(f"--plugin {file}: {reason}")


def list_(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help="what to list")] = "all",
    as_json: Annotated[bool, typer.Option("--json", help="print JSON, for scripts")] = False,
    plugin: options.Plugins = None,
) -> None:
    """List installed methods, metrics, scenes, presets, and more.

    Plugins that cannot be used are listed with their error; the exit code is then 1. Scenes and
    reports are found without importing them; rlbench doctor imports every plugin.

    Examples:

    \b
      rlbench list
      rlbench list methods --json
    """
    load_plugins(plugin, allow_broken=True)
    from rlbench.benchmark.listing import list_installed

    installed = list_installed(kind)
    if as_json:
        typer.echo(json.dumps(installed, indent=1))
    else:
        from rlbench.cli.installed import print_installed

        print_installed(installed)
    if any("broken" in row for rows in installed.values() for row in rows):
        raise typer.Exit(1)


def check(
    methods: Annotated[
        list[str],
        typer.Argument(metavar="METHODS", help="names a,b; family/*; all"),
    ],
    plugin: options.Plugins = None,
    device: options.Device = "cpu",
    debug: Annotated[
        bool, typer.Option("--debug", help="print the traceback of an exception of a method")
    ] = False,
) -> None:
    """Check that methods keep the contract.

    Each line is a check that passed, failed (with a remedy), or does not apply (-). The checks run
    on a small closed-form clip, with random weights, so they say nothing about quality. The exit
    code is 1 if a check failed.

    Examples:

    \b
      rlbench check ours
      rlbench check bright --plugin bright.py
      rlbench check bright --plugin bright.py --debug
      rlbench check all
    """
    patterns = arguments.split_names(methods)
    load_plugins(plugin, allow_broken="all" in patterns)
    from rlbench.benchmark.api import select_device
    from rlbench.checks.conformance.run import check_methods

    raise typer.Exit(0 if check_methods(patterns, select_device(device), debug) else 1)

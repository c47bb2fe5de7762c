"""The commands list and check, and the plugin files that many commands accept."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli import arguments, options
from rlbench.cli.json_output import ChecksOutput, print_json
from rlbench.cli.verbosity import note

__all__ = ["check", "list_", "load_plugins", "load_rows"]

ROWS = "Its rows get this reason; all others are done"  # of a method that cannot be imported

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


def load_rows(context: typer.Context, files: list[Path] | None, patterns: Iterable[str]) -> None:
    """Register plugin files for a command that does the rows of `patterns` one after another.

    Until the command ends, a method that cannot be imported has rows that fail, with its reason.
    Raises PluginError for a file that does not parse, and as `registry.with_broken`.
    """
    from rlbench import registry

    load_plugins(files, allow_broken=True)
    context.with_resource(registry.with_broken(patterns, lambda reason: note(f"{reason}. {ROWS}")))


def list_(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help="what to list")] = "all",
    as_json: options.Json = False,
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
        print_json(installed)
    else:
        from rlbench.cli.installed import print_installed

        print_installed(installed)
    if any("broken" in row for rows in installed.values() for row in rows):
        raise typer.Exit(1)


def check(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    device: options.Device = "cpu",
    debug: Annotated[
        bool, typer.Option("--debug", help="print the traceback of an exception of a method")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Check that methods keep the contract.

    Each line is a check that passed, failed (with a remedy), or does not apply (-). The checks run
    on a small closed-form clip, with random weights, so they say nothing about quality. The exit
    code is 1 if a check failed.

    Examples:

    \b
      rlbench check -m ours
      rlbench check -m bright --plugin bright.py
      rlbench check -m bright --plugin bright.py --debug
      rlbench check -m all
    """
    patterns = arguments.require_methods(methods)
    load_rows(context, plugin, patterns)
    from rlbench.benchmark.api import select_device
    from rlbench.checks.conformance.run import check_methods

    output = ChecksOutput() if as_json else None
    has_passed = check_methods(
        patterns, select_device(device), debug, output.add if output else None
    )
    if output:
        print_json(output)
    raise typer.Exit(0 if has_passed else 1)

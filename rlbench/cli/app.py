"""The command line: every command, and how its errors are told."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from rlbench.cli.benchmark import regress, report, run
from rlbench.cli.clips import lint, render
from rlbench.cli.images import images
from rlbench.cli.importing import import_
from rlbench.cli.methods import Plugins, check, load_plugins
from rlbench.cli.training import crossval, train
from rlbench.errors import RlbenchError


class _Told(TyperGroup):
    """Commands whose expected errors are one clear message and exit code 2, without a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; errors of our own types are told, all others are defects and rise."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            if not isinstance(error, RlbenchError):
                raise
            typer.secho(f"error: {error}", fg="red", err=True)
            raise SystemExit(2) from error


app = typer.Typer(
    cls=_Told,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"max_content_width": 100},  # examples are there to be copied
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Which adaptive sampler and denoiser gives the least error in a given frame time?\n\n"
    "A first look:  rlbench run --methods ours,ntas && rlbench report all",
)


def _version(asked_for: bool) -> None:
    if asked_for:
        from importlib.metadata import version

        typer.echo(version("rlbench"))
        raise typer.Exit


@app.callback()
def _any(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="print it, and no more"),
    ] = False,
) -> None:
    """Nothing that belongs to all commands is left to do once options are read."""


app.command()(run)


app.command()(images)


@app.command("list")
def list_(
    kind: Annotated[
        str, typer.Argument(help="methods, metrics, scenes, reports, pools, presets, profiles")
    ] = "all",
    as_json: Annotated[bool, typer.Option("--json", help="for scripts")] = False,
    plugin: Plugins = None,
) -> None:
    """List what is installed: methods, metrics, scenes, reports, pools, presets and profiles.

    Examples:

      rlbench list

      rlbench list methods --json
    """
    load_plugins(plugin, listed=True)
    from rlbench.benchmark import listing
    from rlbench.cli import console

    found = listing.list_installed(kind)
    typer.echo(json.dumps(found, indent=1)) if as_json else console.listed(found)


app.command()(render)
app.command("import")(import_)
app.command()(lint)


app.command()(train)
app.command()(crossval)
app.command()(check)


app.command()(report)


app.command()(regress)


@app.command()
def doctor(plugin: Plugins = None) -> None:
    """Say what this machine has, what it lacks, and what would help.

    Examples:

      rlbench doctor
    """
    load_plugins(plugin)
    from rich.console import Console

    from rlbench.checks.console import print_results
    from rlbench.cli.doctor import inspect_machine

    print_results(inspect_machine(), Console())

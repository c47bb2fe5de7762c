"""The command line: all commands, in the order of the pipeline."""

from __future__ import annotations

import platform
from collections.abc import Callable
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.benchmark import run
from rlbench.cli.cache import cache
from rlbench.cli.clips import lint, render
from rlbench.cli.command_group import Command, CommandGroup
from rlbench.cli.compare import compare
from rlbench.cli.crossval import crossval
from rlbench.cli.decide import decide
from rlbench.cli.evaluate import evaluate
from rlbench.cli.images import images
from rlbench.cli.importing import import_
from rlbench.cli.json_output import ChecksOutput, print_json
from rlbench.cli.new import new
from rlbench.cli.plugins import check, list_, load_plugins
from rlbench.cli.regress import regress
from rlbench.cli.reports import report
from rlbench.cli.scenes import scenes
from rlbench.cli.speed import speed
from rlbench.cli.stress import stress
from rlbench.cli.training import train
from rlbench.cli.user_scene import render_scene
from rlbench.cli.verbosity import set_verbosity
from rlbench.cli.video import video
from rlbench.cli.view import view

__all__ = ["app"]

app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    context_settings={
        "max_content_width": 100,  # examples are there to be copied
        "help_option_names": ["-h", "--help"],
    },
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Which adaptive sampler and denoiser gives the least error in a given frame time?\n\n"
    "A first look:  rlbench run --methods ours,ntas && rlbench report all",
)


def _print_version(is_requested: bool) -> None:
    if is_requested:
        from importlib.metadata import version

        typer.echo(version("rlbench"))
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Print what is looked up, cached and skipped, with times."
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print results and errors, and no progress.")
    ] = False,
) -> None:
    set_verbosity(verbose, quiet)


def doctor(plugin: options.Plugins = None, as_json: options.Json = False) -> None:
    """Report what this machine has, lacks, and how to get it.

    Examples:

    \b
      rlbench doctor
    """
    load_plugins(plugin, allow_broken=True)
    from rich.console import Console

    from rlbench.checks.console import print_results
    from rlbench.cli.doctor import inspect_machine

    if as_json:
        output = ChecksOutput()
        output.add(inspect_machine(), title=platform.node())
        print_json(output)
    else:
        print_results(inspect_machine(), Console())


COMMANDS: dict[str, Callable[..., None]] = {
    "doctor": doctor,
    "list": list_,
    "cache": cache,
    "render": render,
    "render-scene": render_scene,
    "scenes": scenes,
    "import": import_,
    "lint": lint,
    "new": new,
    "check": check,
    "stress": stress,
    "speed": speed,
    "train": train,
    "crossval": crossval,
    "run": run,
    "evaluate": evaluate,
    "report": report,
    "decide": decide,
    "compare": compare,
    "images": images,
    "view": view,
    "video": video,
    "regress": regress,
}
for name, command in COMMANDS.items():
    app.command(name, cls=Command)(command)

"""The command line: all commands, in groups by task."""

from __future__ import annotations

import io
import sys
from typing import Annotated

import typer

from rlbench.cli.command import CommandGroup
from rlbench.cli.verbosity import set_verbosity

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


def _print_what_the_terminal_can() -> None:
    """Replace characters that the encoding of a stream lacks, in place of an exception."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


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
    _print_what_the_terminal_can()
    set_verbosity(verbose, quiet)

"""The command lint: check the conventions of clips, or guess the layout of a dump."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.json_output import show_checks
from rlbench.cli.options import file, flag, option


def lint(
    clips: Annotated[
        list[Path],
        typer.Argument(metavar="CLIPS", exists=True, help="a clip, or a folder of clips"),
    ],
    figure: Annotated[
        Path | None, file("PNG to draw; with several clips, one for each", group=None)
    ] = None,
    frames: Annotated[int, option(None, "first frames to read; 0: all", min=0)] = 8,
    guess: Annotated[
        bool, flag(None, "--guess", "CLIPS is a dump of EXR files: guess the layout to import it")
    ] = False,
    layout: Annotated[Path, file("file that --guess writes", group=None)] = Path("engine.toml"),
    as_json: options.Json = False,
) -> None:
    """Check a clip's motion, depth, normals, samples, reference.

    The exit code is 1 if a check failed. With --guess, write the layout of a dump for rlbench
    import instead, with how sure each reading is.

    Examples:

    \b
      rlbench lint my_renders/atrium
      rlbench lint my_renders/ --figure lint.png --frames 0
      rlbench lint --guess dump/ && rlbench import dump/ --layout engine.toml --out clips/
    """
    if guess:
        _write_guess(clips, layout)
        return
    from rlbench.apps.dumps.lint.checks import lint_clips
    from rlbench.clips.stored import find_all_clips

    rows = show_checks(lint_clips(find_all_clips(clips), figure, frames), as_json)
    raise typer.Exit(not all(row["passed"] for row in rows))


def _write_guess(sources: list[Path], layout: Path) -> None:
    """Write the layout of one dump, and print it."""
    from rlbench.apps.dumps.importers.layout import decode_layout, read_layout, ready_layouts
    from rlbench.apps.dumps.lint.guess import (
        format_guess,
        format_unclaimed,
        guess_layout,
        recognize_layout,
    )
    from rlbench.errors import OptionError
    from rlbench.system.paths import check_writable
    from rlbench.system.store import write_text

    if len(sources) != 1 or not sources[0].is_dir():
        raise OptionError("--guess takes one folder of EXR files")
    if layout.exists():
        raise OptionError(f"{layout} exists; name another file with --layout, or remove it")
    check_writable(layout.parent, "--layout")
    if name := recognize_layout(sources[0]):
        text = ready_layouts()[name].read_text()
        unclaimed = format_unclaimed(sources[0], read_layout(name))
        typer.echo(f"sure: the ready layout '{name}' reads it, and no check of motion, depth and")
        typer.echo("normals fails\n")
    else:
        guess = guess_layout(sources[0])
        text = format_guess(guess)
        typer.echo(text)
        unclaimed = format_unclaimed(sources[0], decode_layout(guess.tables, "guess"))
    typer.echo(unclaimed)
    write_text(layout, text + unclaimed)
    typer.echo(f"written to {layout}. Next:")
    typer.echo(f"  rlbench import {sources[0]} --layout {layout} --out clips/")

"""The command scenes: scenes by others, their licences, and bringing them to this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.json_output import ScenesOutput, print_json
from rlbench.cli.options import OUTPUT, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.apps.render.scenes.collection.catalog import CollectionScene
    from rlbench.apps.render.scenes.collection.download import Fetched

HIDDEN = ("files", "main", "sky", "camera")  # of a scene, in its row


def _complete(incomplete: str) -> list[str]:
    from rlbench.apps.render.scenes.collection.catalog import load_catalog

    return [name for name in (*load_catalog(), "all") if name.startswith(incomplete)]


def scenes(
    action: Annotated[
        Literal["list", "get", "pin"],
        typer.Argument(metavar="ACTION", help="list, get, which downloads, or pin"),
    ] = "list",
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAMES",
            help="scenes to get, or all; what to pin: a scene, or OWNER/REPOSITORY@COMMIT:FOLDER",
            autocompletion=_complete,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        option(
            OUTPUT,
            "folder for the scenes, or file for the pin; default: the cache",
            "--out",
            "--folder",
            value="PATH",
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List, download and pin scenes by others.

    A pin names each file of a scene by commit and git blob id. `get` verifies every file by it and
    continues an interrupted download. The variable RLBENCH_SCENES names a folder of scenes that is
    looked at first; `get` copies what it has. Whom to credit is in CREDITS.md beside the files.

    Examples:

    \b
      rlbench scenes
      rlbench scenes get classroom
      rlbench scenes get all
      rlbench scenes pin dining-room
      rlbench scenes pin OWNER/REPOSITORY@COMMIT:FOLDER --out attic.tsv
    """
    words = split_names(names)
    if action == "list":
        if words or out:
            raise OptionError("a list takes no names and no --out. To download: rlbench scenes get")
        _print_scenes(as_json)
    elif action == "get":
        _get(words, out, as_json)
    else:
        if as_json or len(words) != 1:
            raise OptionError("pin one scene: rlbench scenes pin NAME, without --json")
        _pin(words[0], out)


def _print_scenes(as_json: bool) -> None:
    from rlbench.apps.render.scenes.collection.catalog import load_catalog

    rows = [_row(entry) for entry in load_catalog().values()]
    if as_json:
        print_json(ScenesOutput(rows))
        return
    from rlbench.cli.list_ import print_installed

    print_installed({"scenes by others": [{**row, "MB": _format_size(row)} for row in rows]})


def _get(words: Sequence[str], out: Path | None, as_json: bool) -> None:
    """Download scenes. Exits with code 1 where some could not be downloaded."""
    from rlbench.apps.render.scenes.collection.download import DownloadError, UnreachableError

    chosen = _choose(words)
    due = [entry.name for entry in chosen]
    failed: dict[str, str] = {}
    for entry in chosen:
        try:
            fetched = _fetch(entry, out)
        except DownloadError as error:
            failed[entry.name] = str(error)
            typer.secho(f"error: {error}", fg="red", err=True)
            if isinstance(error, UnreachableError):
                break
            continue
        due.remove(entry.name)
        if not as_json:
            counts = f"{fetched.downloaded} downloaded, {fetched.copied} copied, {fetched.kept}"
            typer.echo(
                f"{fetched.folder}: {counts} there already; "
                f"'{entry.title}' by {entry.author}, {entry.licence}"
            )
    if as_json:
        print_json(ScenesOutput([_row(entry) for entry in chosen], failed))
    if due:
        title = f"{len(due)} of {len(chosen)} scenes are not complete"
        typer.echo(f"{title}: {', '.join(due)}", err=True)
        raise typer.Exit(1)


def _choose(words: Sequence[str]) -> list[CollectionScene]:
    """The named scenes, or with `all` every one that is pinned."""
    from rlbench.apps.render.scenes.collection.catalog import find_scene, load_catalog

    if not words:
        raise OptionError("which scenes? rlbench scenes get NAME, or all")
    if "all" not in words:
        return [find_scene(name) for name in dict.fromkeys(words)]
    entries = load_catalog().values()
    if unpinned := [entry.name for entry in entries if not entry.files]:
        typer.echo(f"left out, since not pinned: {', '.join(unpinned)}", err=True)
    return [entry for entry in entries if entry.files]


def _fetch(entry: CollectionScene, out: Path | None) -> Fetched:
    """Download one scene, with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    from rlbench.apps.render.scenes.collection.download import get
    from rlbench.system.progress import LoggedProgress

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    with LoggedProgress(*columns) as bar:
        task = bar.add_task(entry.name, total=len(entry.files))
        return get(entry.name, out, lambda file: bar.advance(task))


def _pin(word: str, out: Path | None) -> None:
    """Write the pin of a scene to a file."""
    from rlbench.apps.render.scenes.collection import catalog
    from rlbench.apps.render.scenes.collection.pins import parse_place, pin
    from rlbench.system.store import write_text

    place = parse_place(word if "@" in word else catalog.place_of(catalog.find_scene(word)))
    name = place[2].rpartition("/")[2] if "@" in word else word
    file = out or catalog.own_pin_file(name)
    text = pin(*place)
    write_text(file, text)
    typer.echo(f"{file}: {text.count(chr(10)) - 1} files")
    if out is None:
        typer.echo(f"to download them: rlbench scenes get {name}")


def _row(entry: CollectionScene) -> dict[str, Any]:
    """A scene as a row of the table and of the JSON document."""
    from rlbench.apps.render.scenes.collection.catalog import describe_state, find_located

    located = find_located(entry)
    return {
        **{key: value for key, value in vars(entry).items() if key not in HIDDEN},
        "presets": list(entry.presets),
        "files": len(entry.files),
        "bytes": entry.bytes,
        "has_unknown_sizes": any(file.bytes is None for file in entry.files),
        "state": describe_state(entry, located),
        "scene": str(located.scene) if located else None,
        "missing": list(located.missing) if located else [],
    }


def _format_size(row: dict[str, Any]) -> str:
    """Megabytes; with a plus where the pin lacks sizes."""
    if not row["files"]:
        return "-"
    return f"{row['bytes'] / 1e6:.1f}{'+' * row['has_unknown_sizes']}"

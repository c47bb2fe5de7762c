"""The command cache: what the cache folder holds, and removing parts of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rlbench.cli import options
from rlbench.cli.arguments import parse_age
from rlbench.cli.json_output import CacheOutput, print_json
from rlbench.cli.options import complete_names, flag, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.benchmark.cache_entries import CacheEntry

REMADE_AT_ONCE = "decoded frames"  # the kind that `prune` removes without a selection


def cache(
    action: Annotated[
        Literal["list", "prune"],
        typer.Argument(metavar="ACTION", help="list, or prune, which removes"),
    ] = "list",
    older_than: Annotated[
        float | None,
        option(None, "prune what was last used before: 30d, 12h, 2w", value="AGE", parse=parse_age),
    ] = None,
    preset: Annotated[
        str | None,
        option(
            None,
            "prune the clips of this preset",
            value="PRESET",
            complete=complete_names("presets"),
        ),
    ] = None,
    dry_run: Annotated[
        bool, flag(None, "--dry-run", "say what prune would remove, and remove nothing")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """List what the cache folder holds, or remove parts of it.

    `prune` removes decoded frames, which the next run decodes again; with --older-than, everything
    that was not used for that time; with --preset, clips of one preset. Whatever it removes can be
    made again. Files that rlbench does not know stay. The variable RLBENCH_CACHE moves the cache.

    Examples:

    \b
      rlbench cache
      rlbench cache prune --dry-run
      rlbench cache prune --older-than 30d
      rlbench cache prune --preset unseen
    """
    from rlbench.benchmark.cache_entries import find_entries, find_unknown
    from rlbench.system.paths import cache_folder

    folder = cache_folder()
    entries = find_entries(folder)
    if action == "list":
        if older_than is not None or preset is not None or dry_run:
            raise OptionError(
                "--older-than, --preset and --dry-run select what is removed: rlbench cache prune"
            )
        unknown = find_unknown(folder, entries)
        _print_entries(folder, entries, unknown, as_json)
        return
    _prune(folder, _select(entries, older_than, preset), dry_run, as_json)


def _select(
    entries: Sequence[CacheEntry], older_than: float | None, preset: str | None
) -> list[CacheEntry]:
    """The entries to remove. Raises OptionError for a preset of which there is no clip."""
    from datetime import UTC, datetime

    from rlbench.registry.near_names import unknown_name

    if older_than is None and preset is None:
        return [entry for entry in entries if entry.kind == REMADE_AT_ONCE]
    presets = sorted({entry.preset for entry in entries if entry.preset})
    if preset is not None and preset not in presets:
        problem = f"--preset {preset}: the cache has no clip of it"
        raise OptionError(unknown_name(problem, preset, presets))
    before = datetime.now(UTC).timestamp() - (older_than or 0.0)
    chosen = [entry for entry in entries if preset in (None, entry.preset)]
    return [entry for entry in chosen if entry.last_used <= before]


def _prune(folder: Path, chosen: Sequence[CacheEntry], dry_run: bool, as_json: bool) -> None:
    from rlbench.benchmark.cache_entries import remove_entry

    output = CacheOutput.of(folder, chosen, ())
    for entry in () if dry_run else chosen:
        remove_entry(entry, folder)
    if as_json:
        print_json(output)
        return
    for row in output.entries:
        typer.echo(f"{row['kind']} {row['name']}: {format_bytes(row['bytes'])}")
    verb = "would be removed" if dry_run else "removed"
    total = format_bytes(sum(row["bytes"] for row in output.entries))
    typer.echo(f"{verb} from {folder}: {len(chosen)} entries, {total}")


def _print_entries(
    folder: Path, entries: Sequence[CacheEntry], unknown: Sequence[Path], as_json: bool
) -> None:
    output = CacheOutput.of(folder, entries, unknown)
    if as_json:
        print_json(output)
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title=str(folder), title_justify="left")
    for column in ("what", "entries", "size", "last used", "made again by"):
        table.add_column(column, justify="right" if column in ("entries", "size") else "left")
    for group, members in output.groups().items():
        size = format_bytes(sum(each["bytes"] for each in members))
        last = max(each["last_used"] for each in members)[:10]
        table.add_row(group, str(len(members)), size, last, members[0]["remade_by"])
    console = Console()
    console.print(table)
    if unknown:
        text = f"{len(unknown)} files that rlbench does not know, which stay: {unknown[0]}"
        console.print(text + ", ..." * (len(unknown) > 1), soft_wrap=True, markup=False)


def format_bytes(count: int) -> str:
    """A number of bytes in kB, MB or GB.

    >>> format_bytes(184_000_000)
    '184.0 MB'
    """
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count / 1e3:.1f} kB"

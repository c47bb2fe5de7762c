"""The command list: what is installed, and the tables that show it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import typer

from rlbench.cli import options
from rlbench.cli.json_output import print_json
from rlbench.cli.methods import load_plugins

Kind = Literal[
    "all", "methods", "metrics", "scenes", "reports", "pools", "presets", "profiles"
]  # those of `rlbench.benchmark.listing`
COLUMNS = {  # of the kinds that have more than these, in their order
    "methods": ("name", "question", "inputs", "spp", "adaptive", "recordable", "weights"),
    "metrics": ("name", "unit", "direction", "convention"),
    "presets": ("name", "height", "width", "frames", "reference_spp", "scenes", "takes", "purpose"),
    "scenes by others": ("name", "title", "author", "licence", "MB", "state", "presets"),
}
FILE_WIDTH = 180  # characters of a line that goes to no terminal


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
        print_installed(installed)
    if any("broken" in row for rows in installed.values() for row in rows):
        raise typer.Exit(1)


def print_installed(installed: dict[str, list[dict[str, Any]]]) -> None:
    """Print one table for each kind, and below it why rows are not recordable or plugins broken."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:  # into a file or a pager, which has no width to fit
        console = Console(width=FILE_WIDTH)
    for kind, rows in installed.items():
        working = [row for row in rows if "broken" not in row]
        columns = COLUMNS.get(kind) or tuple(working[0] if working else ("name",))
        table = Table(title=kind, title_justify="left")
        for column in columns:
            is_name = column == "name"  # names are there to be copied, so they stay on one line
            table.add_column(column, no_wrap=is_name, overflow="ellipsis" if is_name else "fold")
        for row in working:
            table.add_row(*(_format_value(row[column]) for column in columns))
        console.print(table)
        for reason in dict.fromkeys(filter(None, (row.get("eager_reason") for row in rows))):
            names = [row["name"] for row in rows if row.get("eager_reason") == reason]
            console.print(f"not recordable: {', '.join(names)}: {reason}", markup=False)
        for row in rows:
            if "broken" in row:
                text = f"{row['name']} (from {row['from']}) cannot be imported: {row['broken']}"
                console.print(text, style="red", markup=False)


def _format_value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list) and len(value) == 2 and all(isinstance(v, float) for v in value):
        return f"{value[0]:g} to {value[1]:g}"  # a range
    if isinstance(value, list):
        return " ".join(f"{item:g}" if isinstance(item, float) else str(item) for item in value)
    return str(value)

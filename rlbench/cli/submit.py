"""The command submit: results as one file that others can verify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.cli.plugins import load_rows
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from rlbench.benchmark.clip_sources import StoredSource

__all__ = ["submit"]


def submit(
    context: typer.Context,
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="folder of rlbench run", file_okay=False)
    ] = Path("results"),
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="file to write; default: RESULTS/submission.rlbench.json",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    licence: Annotated[
        str,
        typer.Option(metavar="SPDX", help="licence of the numbers", rich_help_panel=options.OUTPUT),
    ] = "CC-BY-4.0",
    contact: Annotated[
        str,
        typer.Option(
            metavar="TEXT",
            help="who answers questions: an address or a page; default: nobody",
            rich_help_panel=options.OUTPUT,
        ),
    ] = "",
    note: Annotated[
        str,
        typer.Option(
            metavar="TEXT", help="what readers should know", rich_help_panel=options.OUTPUT
        ),
    ] = "",
    methods: options.RowMethods = None,
    plugin: options.Plugins = None,
    clips: options.Clips = None,
) -> None:
    """Write results to one file that others can verify.

    The file has scores of each frame, times, and hashes of clips, code and weights. Nothing is
    sent. Results that are not of today's code, weights and clips are refused. Cells that an error
    stopped, and those of a method that cannot be imported, are named and left out; the exit code is
    then 1.

    Examples:

    \b
      rlbench submit results --out mine.rlbench.json --contact https://example.org/me
      rlbench submit results -m bright,ours --plugin bright.py --licence CC0-1.0
    """
    from rlbench.benchmark.results import RowName, read
    from rlbench.benchmark.submission.collect import collect_submission, stored_clips
    from rlbench.benchmark.submission.document import SUFFIX, write_submission
    from rlbench.benchmark.submission.failures import drop_failed
    from rlbench.cli.reports import select_rows
    from rlbench.system.paths import check_writable

    target = out or results / f"submission{SUFFIX}"
    rows = read(results)
    check_writable(target.parent)
    names = arguments.split_names(methods)
    own = {RowName.parse(row).method for row in rows["method"].unique()}
    load_rows(context, plugin, names or sorted(own))
    if names:
        rows = select_rows(rows, names, results)
    rows, failed = drop_failed(rows, results)
    for cell, reason in failed.items():
        typer.echo(f"left out: {cell}: {reason}", err=True)
    if rows.empty:
        raise OptionError(f"{results} has no cell without an error, so there is nothing to submit")
    sources = stored_clips(rows, clips)
    submission = collect_submission(
        rows, results, sources, licence=licence, contact=contact, note=note
    )
    _check_current(rows, results, sources)
    written = write_submission(submission, target)
    typer.echo(
        f"{target}: {len(written.cells)} cells, content hash {written.content_hash[:12]}. "
        f"Check it as others will: rlbench verify {target}"
    )
    if failed:
        raise typer.Exit(1)


def _check_current(rows: pd.DataFrame, results: Path, sources: Mapping[str, StoredSource]) -> None:
    """Refuse results of other content than today's; say which rows nobody else can measure."""
    from rlbench.benchmark.results import cells
    from rlbench.benchmark.submission.current import outdated_cells, uncheckable_methods

    methods = set(rows["method"])
    stored = [cell for cell in cells(results) if cell.key.method in methods and not cell.is_failed]
    if outdated := outdated_cells(stored, sources):
        raise OptionError(
            f"{len(outdated)} cells, such as {outdated[0]}, were measured with other code, "
            "weights, packages or clips than those here. Repeat the rlbench run that wrote them"
        )
    if unknown := uncheckable_methods(methods):
        typer.echo(
            f"{', '.join(unknown)}: the weights do not ship with an installed method, so others "
            "cannot measure these rows again",
            err=True,
        )

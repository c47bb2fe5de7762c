"""The command verify: check a submission, and measure some of its cells again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.plugins import load_plugins

if TYPE_CHECKING:
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.submission.document import Submission
    from rlbench.checks.result import CheckResult

__all__ = ["verify"]


def verify(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", exists=True, dir_okay=False, help="a submission")
    ],
    against: Annotated[
        str,
        typer.Option(
            metavar="RESULTS|baseline",
            help="compare PSNR with a results folder, the shipped baseline, or a baseline's FILE",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = "",
    rerun: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="measure N random cells again on this machine",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = 0,
    plugin: options.Plugins = None,
    clips: options.Clips = None,
) -> None:
    """Check a submission: hashes, clips, budgets, plausible scores.

    The exit code is 1 if a check failed. The content hash finds changes of the file; it does not
    say who wrote it. Only --rerun shows that a score can be measured.

    Examples:

    \b
      rlbench verify mine.rlbench.json
      rlbench verify mine.rlbench.json --against baseline --rerun 3
      rlbench verify mine.rlbench.json --rerun 3 --plugin bright.py
    """
    load_plugins(plugin)
    from rich.console import Console

    from rlbench.benchmark.submission.content_checks import check_content
    from rlbench.benchmark.submission.document import read_submission
    from rlbench.benchmark.submission.machine_checks import check_against_machine
    from rlbench.benchmark.submission.score_checks import check_against_scores
    from rlbench.checks.console import print_results

    submission = read_submission(file)
    compared = [check_against_scores(submission, against)] if against else []
    sources = _clips_of(submission, clips)
    results = [*check_content(submission), *check_against_machine(submission, sources), *compared]
    results += _measure_again(submission, rerun, sources)
    title = f"{file.name}: {len(submission.cells)} cells of {submission.preset or 'own clips'}"
    title += f", rlbench {submission.version}, licence {submission.licence}"
    raise typer.Exit(0 if print_results(results, Console(), title) else 1)


def _clips_of(submission: Submission, folders: list[Path] | None) -> dict[str, StoredSource]:
    """The submission's clips that are here, in `folders` or in the cache."""
    import pandas as pd

    from rlbench.benchmark.submission.collect import stored_clips

    names = [{"clip": clip.name, "preset": submission.preset} for clip in submission.clips]
    return stored_clips(pd.DataFrame(names, columns=["clip", "preset"]), folders)


def _measure_again(
    submission: Submission, number: int, sources: Mapping[str, StoredSource]
) -> list[CheckResult]:
    """Random cells, measured again; nobody but this process knows which."""
    import tempfile
    from random import SystemRandom

    from rlbench.benchmark.submission.score_checks import measure_again, select_cells
    from rlbench.checks.result import not_applicable
    from rlbench.cli import console

    if not number:
        reason = "no cell was; --rerun 3 measures three of them on this machine"
        return [not_applicable("measured again", reason)]
    cells = select_cells(submission, number, SystemRandom())
    if not cells:
        reason = "no row can be measured here: its method is not installed, or its weights are not"
        return [not_applicable("measured again", reason)]
    with (
        tempfile.TemporaryDirectory() as folder,
        console.counting("measuring again", len(cells)) as advance,
    ):
        return measure_again(submission, cells, sources, Path(folder), advance)

"""The command report: write tables and plots from the results."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rlbench.cli import arguments, options
from rlbench.errors import OptionError, RlbenchError

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.shown_clips import ShownClips

__all__ = ["report", "select_budgets", "select_rows"]


def report(
    name: Annotated[str, typer.Argument(metavar="NAME", help="name of a report, or all")] = "all",
    methods: options.RowMethods = None,
    results: options.Results = Path("results"),
    clips: options.Clips = None,
    spp: Annotated[
        float | None,
        typer.Option(
            parser=arguments.parse_positive,
            metavar="SPP",
            help="budget of reports that show images; default: that nearest to 1 spp",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder to write to; default: RESULTS/report",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
) -> None:
    """Write reports from the results: tables and plots.

    `all` writes every report that the results have rows for, and says why it skips the others.
    Some reports show images: they need results of `rlbench run --keep-images`, and the first
    methods in --methods are those that they compare.

    Examples:

    \b
      rlbench report all
      rlbench report pareto --results results/ --out figures/ --methods ours,ntas
      rlbench report table1
      rlbench report ablation --methods 'ours/*'
      rlbench report zooms --methods ours,ntas --spp 4
    """
    from rlbench.benchmark.results import MissingRowsError, read

    rows = read(results)
    if names := arguments.split_names(methods):
        rows = select_rows(rows, names, results)
    writers = _find_writers(name)
    images = partial(_find_images, results, rows, clips, spp)
    failures: dict[str, list[str]] = {}  # names of reports, by error
    for each, has_images in writers.items():
        try:
            for file in _write(each, rows, out or results / "report", has_images and images, names):
                typer.echo(file)
        except Exception as error:
            if not isinstance(error, RlbenchError):
                raise
            if name == "all" and isinstance(error, MissingRowsError):
                typer.echo(f"report {each} is skipped: {error}", err=True)
            else:
                failures.setdefault(str(error), []).append(each)
    if failures:
        raise OptionError(
            "; ".join(f"cannot write {', '.join(names)}: {why}" for why, names in failures.items())
        )


def _find_writers(name: str) -> dict[str, bool]:
    """The reports to write, and whether each shows images; `all` is all. Raises PluginError."""
    from rlbench import registry
    from rlbench.registry.near_names import suggest

    groups = ("reports", "image_reports")
    known = {each: group == groups[1] for group in groups for each in registry.list_plugins(group)}
    if name != "all" and name not in known:
        raise registry.PluginError(
            f"'{name}' is not a report; there are: {', '.join(sorted(known))}{suggest(name, known)}"
        )
    return known if name == "all" else {name: known[name]}


def _write(
    name: str,
    rows: pd.DataFrame,
    folder: Path,
    images: Callable[[], ShownClips] | Literal[False],
    methods: Sequence[str],
) -> list[Path]:
    """Write one report and return its files; `images` finds those of the results."""
    from rlbench import registry

    if images is False:
        return list(registry.load_or_explain("reports", name)(rows, folder))
    writer = registry.load_or_explain("image_reports", name)
    return list(writer(rows, folder, images(), methods))


def _find_images(
    results: Path, rows: pd.DataFrame, clips: list[Path] | None, spp: float | None
) -> ShownClips:
    """The clips with kept images. Raises MissingRowsError where there are none."""
    from rlbench.benchmark.results import MissingRowsError
    from rlbench.cli.view import find_images

    found, reason = find_images(results, rows, clips, None if spp is None else (spp,))
    if reason:
        raise MissingRowsError(reason)
    return found


def select_rows(table: pd.DataFrame, methods: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of methods, given by names in the table or by patterns of installed methods.

    Raises OptionError for a name without rows, and PluginError for a name that is neither in the
    table nor installed.
    """
    from rlbench import registry
    from rlbench.benchmark.results import RowName, select_methods

    available = set(table["method"])  # also of plugins that are not loaded now
    exact = [name for name in methods if RowName.parse(name).label or name in available]
    patterns = [name for name in methods if name not in exact]
    names = exact + registry.expand(patterns, pretrained_only=False)
    rows = table[select_methods(table, names)]
    single = [n for n in methods if n.partition("/")[0] != "all" and not n.endswith("/*")]
    missing = [name for name in single if not select_methods(table, [name]).any()]
    if missing or rows.empty:
        raise OptionError(
            f"{results} has no rows of {', '.join(missing or methods)}; "
            f"available: {_join(available)}"
        )
    return rows


def select_budgets(table: pd.DataFrame, spp: Collection[float], results: Path) -> pd.DataFrame:
    """The rows of these budgets. Raises OptionError for a budget without rows."""
    available = set(table["target_spp"])
    if unknown := [f"{budget:g}" for budget in spp if budget not in available]:
        raise OptionError(
            f"--spp {','.join(unknown)}: {results} has no rows of it; "
            f"available: {', '.join(f'{budget:g}' for budget in sorted(available))}"
        )
    return table[table["target_spp"].isin(list(spp))]


def _join(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"

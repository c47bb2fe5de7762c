"""The command report: write tables and plots from the results."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.json_output import ReportOutput, print_json
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import MEASUREMENT, complete_names, folder, number, option
from rlbench.cli.selection import find_images, read_rows
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError, RlbenchError
from rlbench.registry.near_names import unknown_name
from rlbench.system.paths import check_no_link, check_writable

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.shown_clips import ShownClips


def report(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="name of a report, or all",
            autocompletion=complete_names("reports", ("all",)),
        ),
    ] = "all",
    methods: options.RowMethods = None,
    results: options.Results = Path("results"),
    out: Annotated[Path | None, folder("folder to write to; default: RESULTS/report")] = None,
    clips: options.Clips = None,
    spp: Annotated[
        float | None,
        number(
            MEASUREMENT, "budget of reports that show images; default: that nearest to 1 spp", "SPP"
        ),
    ] = None,
    against: Annotated[
        list[str] | None,
        option(
            MEASUREMENT,
            "results of other presets a,b, whose order of rows the report real compares",
            value="FOLDERS",
        ),
    ] = None,
    gbuffer_ms: options.GbufferMs = None,
    plugin: options.Plugins = None,
    as_json: options.Json = False,
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
      rlbench report real --results results/real --against results,results/unseen
    """
    load_plugins(plugin)
    from reports.analysis.rows import charge_gbuffer
    from rlbench.benchmark.results import UNFINISHED

    writers = _find_writers(name)
    target = out or check_no_link(results, results / "report")
    rows = charge_gbuffer(read_rows(results, methods), gbuffer_ms)
    if (results / UNFINISHED).exists():
        note(f"{results}: rlbench evaluate did not finish, so scores are missing; repeat it")
    names = split_names(methods)
    others = _read_others(name, [Path(each) for each in split_names(against)])
    check_writable(target)
    output = ReportOutput()
    images = partial(_find_images, results, rows, clips, spp)
    for each, has_images in writers.items():
        write = partial(_write, each, rows, target, has_images and images, names, others)
        files = _try_to_write(each, write, output, is_one_of_all=name == "all")
        if not as_json:
            for file in files:
                typer.echo(file)
    if as_json:
        print_json(output)
    if output.failed:
        names_by_error: dict[str, list[str]] = {}
        for each, why in output.failed.items():
            names_by_error.setdefault(why, []).append(each)
        faults = [f"cannot write {', '.join(n)}: {why}" for why, n in names_by_error.items()]
        raise OptionError("; ".join(faults))


def _find_writers(name: str) -> dict[str, bool]:
    """The reports to write, and whether each shows images; `all` is all. Raises OptionError."""
    from rlbench import registry

    groups = ("reports", "image_reports")
    known = {each: group == groups[1] for group in groups for each in registry.list_plugins(group)}
    if name not in ("all", *known):
        problem = f"'{name}' is not a report"
        raise OptionError(unknown_name(problem, name, ["all", *sorted(known)], "; there are"))
    return known if name == "all" else {name: known[name]}


def _try_to_write(
    name: str, write: Callable[[], list[Path]], output: ReportOutput, is_one_of_all: bool
) -> list[Path]:
    """Write a report, and note in `output` what became of it; returns its files."""
    from rlbench.benchmark.results import MissingRowsError

    try:
        files = write()
    except Exception as error:
        if not isinstance(error, RlbenchError):
            raise
        if is_one_of_all and isinstance(error, MissingRowsError):
            output.skipped[name] = str(error)
            note(f"report {name} is skipped: {error}")
        else:
            output.failed[name] = str(error)
        return []
    output.files.extend(map(str, files))
    return files


def _write(
    name: str,
    rows: pd.DataFrame,
    folder: Path,
    images: Callable[[], ShownClips] | Literal[False],
    methods: Sequence[str],
    others: Mapping[str, pd.DataFrame],
) -> list[Path]:
    """Write one report and return its files; `images` finds those of the results."""
    from rlbench import registry

    if images is False:
        writer = registry.load_or_explain("reports", name)
        extra: dict[str, object] = {}
        if others and _takes("against", writer):
            extra["against"] = others
        if _takes("trained", writer):
            from rlbench.benchmark.listing import frames_trained

            extra["trained"] = frames_trained(rows)
        return list(writer(rows, folder, **extra))
    writer = registry.load_or_explain("image_reports", name)
    return list(writer(rows, folder, images(), methods))


def _read_others(name: str, folders: Sequence[Path]) -> dict[str, pd.DataFrame]:
    """The results of --against by preset, or by folder where it holds several or none.

    Raises OptionError for a report that compares no presets, and for two folders of one preset.
    """
    from rlbench import registry
    from rlbench.benchmark.results import read

    if (
        folders
        and name != "all"
        and not _takes("against", registry.load_or_explain("reports", name))
    ):
        raise OptionError(f"--against: report '{name}' compares no presets. Omit it, or write real")
    tables: dict[str, pd.DataFrame] = {}
    for each in folders:
        table = read(each)
        presets = sorted(set(table["preset"]) - {""})
        label = presets[0] if len(presets) == 1 else str(each)
        if label in tables:
            raise OptionError(f"--against {each}: another folder has preset {label} too. Name one")
        tables[label] = table
    return tables


def _takes(argument: str, writer: Callable[..., object]) -> bool:
    """True if a report uses more than results: those of other presets, or how long rows trained."""
    return argument in inspect.signature(writer).parameters


def _find_images(
    results: Path, rows: pd.DataFrame, clips: list[Path] | None, spp: float | None
) -> ShownClips:
    """The clips with kept images. Raises MissingRowsError where there are none."""
    from rlbench.benchmark.results import MissingRowsError

    found, reason = find_images(results, rows, clips, None if spp is None else (spp,))
    if reason:
        raise MissingRowsError(reason)
    return found

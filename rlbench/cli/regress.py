"""The command regress: compare scores and speeds with a baseline, and write what was found."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import MEASUREMENT, OUTPUT, file, flag, folder, option
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError, RlbenchError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.regression.baseline import Baseline
    from rlbench.benchmark.regression.comparison import RegressionReport, SpeedResult
    from rlbench.benchmark.regression.crops import Crops


def regress(
    methods: options.RowMethods = None,
    results: options.Results = Path("results"),
    baseline: Annotated[
        str,
        option(
            OUTPUT,
            "a baseline that ships, such as mini, or a JSON file; default: the shipped one of "
            "the results' preset",
            value="NAME|FILE",
        ),
    ] = "",
    update: Annotated[
        bool,
        flag(
            OUTPUT,
            "--update",
            "rewrite the baseline FILE from the results; with --methods, their entries alone",
        ),
    ] = False,
    speed: Annotated[
        list[str] | None,
        option(
            MEASUREMENT,
            "largest ratio of the inference times of two rows; both are timed now, on "
            "generated frames; can be repeated",
            value="A/B<=RATIO",
        ),
    ] = None,
    junit: Annotated[Path | None, file("write JUnit XML, a test case for each cell")] = None,
    summary: Annotated[
        Path | None,
        file(
            "write Markdown with crops of the worst change in a folder beside it; also added "
            "to $GITHUB_STEP_SUMMARY"
        ),
    ] = None,
    before: Annotated[
        Path | None, folder("results with kept images of the code before, for the crops")
    ] = None,
    clips: options.Clips = None,
    plugin: options.Plugins = None,
    device: options.Device = "auto",
) -> None:
    """Compare scores, and ratios of times, with a baseline.

    With a baseline that ships, the rows of the results are compared; with -m all, or a baseline of
    your own, a row that the results lack is missing. The exit code is 1 if a score fell by more
    than its cell is allowed, if a cell of such a row is missing, or if a ratio of times exceeds its
    gate beyond doubt. Smaller falls are shown. --update writes a baseline of your own; where the
    results have several seeds, each cell is allowed what reruns vary by.

    Examples:

    \b
      rlbench regress --results results/ --junit regress.xml --summary regress.md
      rlbench regress --methods mean,ours
      rlbench regress --results mine/ --update --baseline mine.json
      rlbench regress --speed 'ours / oidn <= 1.3'
    """
    load_plugins(plugin)
    from rlbench.benchmark.regression.baseline import find_baseline, load_baseline, only_preset
    from rlbench.benchmark.regression.comparison import compare
    from rlbench.benchmark.results import read
    from rlbench.system.paths import check_writable

    for word, target in (("--junit", junit), ("--summary", summary)):
        if target:
            check_writable(target.parent, word)
    names = split_names(methods)
    if update:
        _update(results, baseline, names)
        return
    rows = read(results)
    expected = load_baseline(find_baseline(baseline, only_preset(rows)))
    names = _compared_rows(names, rows, expected, baseline)
    if names:
        rows, expected = select_baseline(rows, expected, names)
    comparison = compare(rows, expected, subset=bool(names))
    if gates := [*expected.speed, *(speed or [])]:
        comparison = replace(comparison, speed=_measure_speed(gates, device))
    typer.echo(comparison.text())
    if junit:
        from rlbench.benchmark.regression.pages import write_junit

        write_junit(comparison, junit)
    if summary:
        from rlbench.benchmark.regression.pages import append_to_job_summary, write_summary

        crops = _crop_worst(comparison, rows, expected.seed, clips, results, before, summary)
        write_summary(comparison, crops, summary)
        append_to_job_summary(comparison, crops)
    raise typer.Exit(0 if comparison.has_passed else 1)


def _compared_rows(
    names: list[str], rows: pd.DataFrame, expected: Baseline, baseline: str
) -> list[str]:
    """The methods to compare; empty for all. By default, of a baseline that ships, the measured."""
    from rlbench.benchmark.regression.baseline import shipped_baselines

    if names == ["all"] or not (names or not baseline or baseline in shipped_baselines()):
        return []
    if names:
        return names
    measured = set(rows["method"])
    count = len({entry.method for entry in expected.entries} - measured)
    note(f"{count} rows of the baseline are not in the results and not compared; -m all needs them")
    return sorted(measured)


def select_baseline(
    table: pd.DataFrame, baseline: Baseline, methods: Collection[str]
) -> tuple[pd.DataFrame, Baseline]:
    """The rows and the baseline entries of some methods.

    Raises OptionError for a method that has neither.
    """
    available = {*table["method"], *(entry.method for entry in baseline.entries)}
    if unknown := sorted(set(methods) - available):
        problem = f"--methods {','.join(unknown)}: neither the results nor the baseline have it"
        raise OptionError(unknown_name(problem, unknown[0], sorted(available)))
    entries = tuple(entry for entry in baseline.entries if entry.method in methods)
    return table[table["method"].isin(methods)], replace(baseline, entries=entries)


def _update(results: Path, baseline: str, methods: list[str]) -> None:
    from rlbench.benchmark.regression.baseline import shipped_baselines, update_baseline
    from rlbench.benchmark.results import read

    if not baseline or baseline in shipped_baselines():
        raise OptionError(
            "--update writes a file and leaves shipped baselines as they are. Name it: --baseline "
            "FILE.json"
        )
    entries = update_baseline(read(results), Path(baseline), methods).entries
    typer.echo(f"{baseline}: {len(entries)} entries written")


def _measure_speed(gates: Collection[str], device: str) -> tuple[SpeedResult, ...]:
    from rlbench.benchmark.planning import select_device
    from rlbench.benchmark.regression.comparison import measure_gates, parse_gate
    from rlbench.cli import console

    parsed = [parse_gate(gate) for gate in gates]
    rows = {name for gate in parsed for name in (gate.row, gate.reference)}
    with console.counting("timing", len(rows)) as advance:
        return tuple(measure_gates(parsed, select_device(device), on_done=advance))


def _crop_worst(
    comparison: RegressionReport,
    rows: pd.DataFrame,
    seed: int,
    clips: list[Path] | None,
    results: Path,
    before: Path | None,
    summary: Path,
) -> Crops | str:
    """Crops of the worst change, or why there are none; empty where nothing fell."""
    from rlbench.benchmark.regression.crops import write_crops

    if not (worst := comparison.worst):
        return ""
    folder = summary.with_name(f"{summary.stem}-crops")
    try:
        sources = _stored_clips(rows, clips)
        return write_crops(worst, rows, seed, sources, results, folder, before)
    except Exception as error:  # whatever a method may raise: the comparison is told without crops
        prefix = "" if isinstance(error, RlbenchError) else f"{type(error).__name__}: "
        return f"{prefix}{error}"


def _stored_clips(rows: pd.DataFrame, clips: list[Path] | None) -> list[StoredSource]:
    """The clips in folders, or those of the results' preset in the cache; nothing is rendered."""
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.clips.stored import find_clips
    from rlbench.system import paths

    if clips is None:
        folders = {paths.clips_folder() / preset for preset in rows["preset"] if preset}
    else:
        folders = set(clips)
    found = (find_clips(folder) for folder in sorted(folders) if folder.is_dir())
    return [StoredSource(path) for each in found for path in each]

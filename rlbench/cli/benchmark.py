"""The commands run, report and regress."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench import errors
from rlbench.cli import arguments, benchmark
from rlbench.cli.clips import Clips, Engine, Preset, RayAddress, Scenes, Takes
from rlbench.cli.methods import Device, Methods, Plugins, load_plugins
from rlbench.errors import OptionError, RlbenchError

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.baseline import Baseline

Results = Annotated[Path, typer.Option(help="folder of the results table")]


def part(
    table: pd.DataFrame, baseline: Baseline, methods: Collection[str]
) -> tuple[pd.DataFrame, Baseline]:
    """The rows and the entries of some methods. Raises AskedError for one that neither has."""
    have = {*table["method"], *(entry.method for entry in baseline.entries)}
    if unknown := sorted(set(methods) - have):
        raise OptionError(
            f"--only {','.join(unknown)}: neither results nor baseline have it; there is: "
            f"{', '.join(sorted(have)) or 'nothing'}"
        )
    entries = tuple(entry for entry in baseline.entries if entry.method in methods)
    return table[table["method"].isin(methods)], replace(baseline, entries=entries)


def rows(table: pd.DataFrame, methods: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of methods, by any name that the table has or a pattern leads to.

    Raises AskedError where a single name has none, and PluginError for one that is in neither.
    """
    from rlbench import registry
    from rlbench.benchmark.results import RowName, select_methods

    known = set(table["method"])  # of plugins too, which need not be here
    exact = [name for name in methods if RowName.parse(name).label or name in known]
    patterns = [name for name in methods if name not in exact]
    wanted = exact + registry.expand(patterns, pretrained_only=False)  # what has rows had weights
    found = table[select_methods(table, wanted)]
    single = [n for n in methods if n.partition("/")[0] != "all" and not n.endswith("/*")]
    absent = [name for name in single if not select_methods(table, [name]).any()]
    if absent or found.empty:
        have = ", ".join(sorted(known)) or "no rows"
        raise OptionError(
            f"{results} has no rows of {', '.join(absent or methods)}; it has: {have}"
        )
    return found


def run(
    methods: Methods = ["all"],  # noqa: B006 - typer reads it and never changes it
    scenes: Scenes = None,
    spp: Annotated[str, typer.Option(help="budgets, samples per pixel")] = "0.5,1,2,4",
    preset: Preset = "mini",
    takes: Takes = None,
    clips: Clips = None,
    pool: Annotated[
        str, typer.Option(help="stored samples, or live: traced when they are bought")
    ] = "stored",
    seed: Annotated[
        str, typer.Option(help="one or more, of the order of sale and of rounding")
    ] = "0",
    device: Device = "auto",
    out: Annotated[Path, typer.Option(help="results folder; it is added to")] = Path("results"),
    cost: Annotated[
        str, typer.Option(help="time of a sample: measured, paper-2080ti, or a TOML file")
    ] = "measured",
    weights: Annotated[
        str | None,
        typer.Option(help="NAME=FILE (rows METHOD@NAME), a file, or random; default the shipped"),
    ] = None,
    half: Annotated[
        bool, typer.Option("--half", help="networks in bfloat16 (rows METHOD@bf16)")
    ] = False,
    plugin: Plugins = None,
    limit_frames: Annotated[
        int | None, typer.Option(min=1, help="first frames of each clip only, for trying out")
    ] = None,
    engine: Engine = "local",
    ray_address: RayAddress = None,
) -> None:
    """Measure methods on clips; what OUT holds already is not run again.

    Examples:

      rlbench run --methods ours,ntas

      rlbench run -m ours -m 'oidn/*' --scenes city --spp 1,4 --cost paper-2080ti --out paper

      rlbench run -m mine --plugin mine.py --clips my_renders/ --out mine

      rlbench run -m ours --scenes temple --pool live --out live

      rlbench run -m ours --weights seed1=runs/seed1/ours/ours.safetensors

      rlbench run -m ours,oidn --half

      rlbench run -m ours,oidn --preset standard --takes main --out large

      rlbench run -m all --preset standard --engine ray --ray-address auto --out large
    """
    load_plugins(plugin)
    if out.exists() and not out.is_dir():
        raise errors.OptionError(f"--out {out} is a file; results are a folder")
    from rlbench import registry
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.benchmark.runner import measure
    from rlbench.cli import console
    from rlbench.parallel.ray_executor import open_executor

    names = arguments.methods(methods)
    called, weights = arguments.weights(weights)
    if (half or weights) and not any(registry.get_variant(name).learned for name in names):
        typer.echo("--half, --weights: no method that was asked for has networks", err=True)
    kinds = {registry.get_variant(name).traits.pool for name in names}
    with open_executor(engine, ray_address) as workers:
        request = RunPlan(
            methods=names,
            clips=arguments.clips(clips, scenes, preset, pool, workers, kinds, takes),
            target_spp=arguments.numbers("--spp", spp, float),
            seeds=arguments.numbers("--seed", seed, int),
            device=arguments.device(device),
            cost=cost,
            weights=weights,
            bf16=half,
            weights_label=called,
            limit_frames=limit_frames,
        )
        with console.progress(request) as bar:
            done = measure(request, out, bar.on_cell, workers, bar.on_timing)
    console.done(done, out)
    if not console.table(request, out):
        raise typer.Exit(1)


def report(
    name: Annotated[str, typer.Argument(help="a report's name, or all")] = "all",
    results: Results = Path("results"),
    out: Annotated[
        Path | None, typer.Option(help="folder to write to; default RESULTS/report")
    ] = None,
    methods: Annotated[
        list[str] | None, typer.Option("--methods", "-m", help="names a,b; default every row")
    ] = None,
) -> None:
    """Write reports from a results table; of all, those that can be written, and why others not.

    Examples:

      rlbench report all

      rlbench report pareto --results results/ --out figures/ --methods ours,ntas

      rlbench report table1

      rlbench report ablation --methods 'ours/*'
    """
    from rlbench import registry
    from rlbench.benchmark import results as table

    rows = table.read(results)
    failed: dict[str, list[str]] = {}  # by reason
    if wanted := arguments.split(methods or []):
        rows = benchmark.rows(rows, wanted, results)
    for each in registry.list_plugins("reports") if name == "all" else [name]:
        try:
            for file in registry.load_or_explain("reports", each)(rows, out or results / "report"):
                typer.echo(file)
        except Exception as error:
            if not isinstance(error, RlbenchError):
                raise
            if name == "all" and isinstance(error, table.MissingRowsError):
                typer.echo(f"{each} was not written: {error}", err=True)
            else:
                failed.setdefault(str(error), []).append(each)
    if failed:
        told = (f"{', '.join(each)} not written: {why}" for why, each in failed.items())
        raise errors.OptionError("; ".join(told))


def regress(
    results: Results = Path("results"),
    baseline: Annotated[Path, typer.Option(help="the committed scores")] = Path(
        "tests/regression/mini.json"
    ),
    update: Annotated[bool, typer.Option("--update", help="rewrite the baseline")] = False,
    only: Annotated[list[str] | None, typer.Option(help="methods a,b; default all")] = None,
) -> None:
    """Compare scores with committed ones; exit code 1 if one fell more than its tolerance.

    Examples:

      rlbench regress --results results/

      rlbench regress --only mean,ours

      rlbench regress --update
    """
    from rlbench.benchmark import regression
    from rlbench.benchmark import results as table
    from rlbench.benchmark.baseline import load_baseline

    wanted = arguments.split(only or [])
    if update and wanted:
        raise errors.OptionError("--update writes the whole baseline anew; run it without --only")
    rows = table.read(results)
    if update:
        written = regression.update_baseline(rows, baseline)
        typer.echo(f"{baseline}: {len(written.entries)} entries")
        return
    known = load_baseline(baseline)
    if wanted:
        rows, known = benchmark.part(rows, known, wanted)
    outcome = regression.compare(rows, known, subset=bool(wanted))
    typer.echo(outcome.text())
    raise typer.Exit(0 if outcome.passed else 1)

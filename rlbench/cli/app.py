"""The command line: every command, and how its errors are told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from rlbench import errors
from rlbench.cli import arguments as asked
from rlbench.cli import benchmark
from rlbench.cli.clips import Clips, Engine, Preset, RayAddress, Scenes, Takes, lint, render
from rlbench.cli.images import images
from rlbench.cli.importing import import_
from rlbench.cli.methods import Device, Methods, Plugins, check, use
from rlbench.cli.training import crossval, train

OURS = ("rlbench", "baselines", "methods", "metrics", "reports")


class _Told(TyperGroup):
    """Commands whose expected errors are one clear message and exit code 2, without a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; errors of our own types are told, all others are defects and rise."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            if not _expected(error):
                raise
            typer.secho(f"error: {error}", fg="red", err=True)
            raise SystemExit(2) from error


app = typer.Typer(
    cls=_Told,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"max_content_width": 100},  # examples are there to be copied
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Which adaptive sampler and denoiser gives the least error in a given frame time?\n\n"
    "A first look:  rlbench run --methods ours,ntas && rlbench report all",
)


def _version(asked_for: bool) -> None:
    if asked_for:
        from importlib.metadata import version

        typer.echo(version("rlbench"))
        raise typer.Exit


@app.callback()
def _any(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="print it, and no more"),
    ] = False,
) -> None:
    """Nothing that belongs to all commands is left to do once options are read."""


Results = Annotated[Path, typer.Option(help="folder of the results table")]


@app.command()
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
        bool, typer.Option("--half", help="networks in bfloat16 (rows METHOD@half)")
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
    use(plugin)
    if out.exists() and not out.is_dir():
        raise errors.AskedError(f"--out {out} is a file; results are a folder")
    from rlbench.benchmark.run_plan import Request
    from rlbench.benchmark.runner import measure
    from rlbench.cli import console as show
    from rlbench.parallel.ray_executor import opened
    from rlbench.registry import lookup as registry

    names = asked.methods(methods)
    called, weights = asked.weights(weights)
    if (half or weights) and not any(registry.variant(name).learned for name in names):
        typer.echo("--half, --weights: no method that was asked for has networks", err=True)
    kinds = {registry.variant(name).traits.pool for name in names}
    with opened(engine, ray_address) as workers:
        request = Request(
            methods=names,
            clips=asked.clips(clips, scenes, preset, pool, workers, kinds, takes),
            spp=asked.numbers("--spp", spp, float),
            seeds=asked.numbers("--seed", seed, int),
            device=asked.device(device),
            cost=cost,
            weights=weights,
            half=half,
            called=called,
            frames=limit_frames,
        )
        with show.progress(request) as bar:
            done = measure(request, out, bar.tell, workers, bar.timed)
    show.done(done, out)
    if not show.table(request, out):
        raise typer.Exit(1)


app.command()(images)


@app.command("list")
def list_(
    kind: Annotated[
        str, typer.Argument(help="methods, metrics, scenes, reports, pools, presets, profiles")
    ] = "all",
    as_json: Annotated[bool, typer.Option("--json", help="for scripts")] = False,
    plugin: Plugins = None,
) -> None:
    """List what is installed: methods, metrics, scenes, reports, pools, presets and profiles.

    Examples:

      rlbench list

      rlbench list methods --json
    """
    use(plugin, listed=True)
    from rlbench.cli import console as show
    from rlbench.cli import listing

    found = listing.listed(kind)
    typer.echo(json.dumps(found, indent=1)) if as_json else show.listed(found)


app.command()(render)
app.command("import")(import_)
app.command()(lint)


app.command()(train)
app.command()(crossval)
app.command()(check)


@app.command()
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
    from rlbench.benchmark import results as table
    from rlbench.registry import lookup as registry

    rows = table.read(results)
    failed: dict[str, list[str]] = {}  # by reason
    if wanted := asked.split(methods or []):
        rows = benchmark.rows(rows, wanted, results)
    for each in registry.names("reports") if name == "all" else [name]:
        try:
            for file in registry.usable("reports", each)(rows, out or results / "report"):
                typer.echo(file)
        except Exception as error:
            if not _expected(error):
                raise
            if name == "all" and isinstance(error, table.LacksError):
                typer.echo(f"{each} was not written: {error}", err=True)
            else:
                failed.setdefault(str(error), []).append(each)
    if failed:
        told = (f"{', '.join(each)} not written: {why}" for why, each in failed.items())
        raise errors.AskedError("; ".join(told))


@app.command()
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
    from rlbench.benchmark import regression as gate
    from rlbench.benchmark import results as table

    wanted = asked.split(only or [])
    if update and wanted:
        raise errors.AskedError("--update writes the whole baseline anew; run it without --only")
    rows = table.read(results)
    if update:
        written = gate.update(rows, baseline)
        typer.echo(f"{baseline}: {len(written.entries)} entries")
        return
    known = gate.load(baseline)
    if wanted:
        rows, known = benchmark.part(rows, known, wanted)
    outcome = gate.compare(rows, known, subset=bool(wanted))
    typer.echo(outcome.text())
    raise typer.Exit(0 if outcome.passed else 1)


@app.command()
def doctor(plugin: Plugins = None) -> None:
    """Say what this machine has, what it lacks, and what would help.

    Examples:

      rlbench doctor
    """
    use(plugin)
    from rlbench.cli import console as show
    from rlbench.cli.doctor import examine

    show.findings(examine())


def _expected(error: Exception) -> bool:
    """Is it of our own types, so that its message says all there is to say?"""
    return type(error).__module__.partition(".")[0] in OURS

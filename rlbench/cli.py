"""The command line: run, list, render, import, lint, train, check, report, regress, doctor."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from rlbench import asked
from rlbench.cli_clips import Engine, Preset, RayAddress, Scenes, Seeds, lint, render
from rlbench.importing.command import import_

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
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Which adaptive sampler and denoiser gives the least error in a given frame time?\n\n"
    "A first look:  rlbench run --methods ours,ntas && rlbench report all",
)

Methods = Annotated[
    list[str], typer.Option("--methods", "-m", help="names a,b; all; family/*; may be repeated")
]
Plugins = Annotated[
    list[Path] | None, typer.Option("--plugin", help="a Python file with FAMILY or METHODS")
]
Results = Annotated[Path, typer.Option(help="folder of the results table")]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda, or a torch device")]


@app.command()
def run(
    methods: Methods = ["all"],  # noqa: B006 - typer reads it and never changes it
    scenes: Scenes = None,
    spp: Annotated[str, typer.Option(help="budgets, samples per pixel")] = "0.5,1,2,4",
    preset: Preset = "mini",
    clips: Annotated[
        list[Path] | None, typer.Option(help="a clip folder, or one of such; instead of a preset")
    ] = None,
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
        str | None, typer.Option(help="a weights file, or random; default the shipped ones")
    ] = None,
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

      rlbench run -m ours -m 'oidn/*' --scenes city --spp 1,4 --cost paper-2080ti

      rlbench run -m mine --plugin mine.py --clips my_renders/

      rlbench run -m ours --scenes temple --pool live

      rlbench run -m all --preset standard --engine ray --ray-address auto
    """
    _use(plugin)
    from rlbench import registry, show
    from rlbench.bench import measure
    from rlbench.cells import Request
    from rlbench.cluster import opened

    with opened(engine, ray_address) as workers:
        request = Request(
            methods=tuple(registry.expand(asked.split(methods))),
            clips=asked.clips(clips, scenes, preset, pool, workers),
            spp=asked.numbers("--spp", spp, float),
            seeds=asked.numbers("--seed", seed, int),
            device=asked.device(device),
            cost=cost,
            weights=weights,
            frames=limit_frames,
        )
        with show.progress(request) as bar:
            done = measure(request, out, bar.tell, workers, bar.timed)
    show.done(done, out)
    show.table(request, out)


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
    _use(plugin)
    from rlbench import listing, show

    found = listing.listed(kind)
    typer.echo(json.dumps(found, indent=1)) if as_json else show.listed(found)


app.command()(render)
app.command("import")(import_)
app.command()(lint)


@app.command()
def train(
    methods: Methods = ["all"],  # noqa: B006
    out: Annotated[Path, typer.Option(help="weights, checkpoints and logs")] = Path("runs"),
    minutes: Annotated[float, typer.Option(help="stop after so many, for each method")] = 1e9,
    frames: Annotated[int, typer.Option(help="crops to see, for each method")] = 12_000,
    batch: Annotated[int, typer.Option(help="crops advanced together")] = 1,
    crop: Annotated[int, typer.Option(help="side of a crop, pixels")] = 128,
    half: Annotated[bool, typer.Option("--half", help="bfloat16 forward pass")] = False,
    seed: int = 0,
    device: Device = "auto",
    preset: Annotated[str | None, typer.Option(help="default train; mini with --holdout")] = None,
    seeds: Seeds = None,
    holdout: Annotated[
        str | None, typer.Option(help="train on the scored scenes but this one")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Train methods on generated scenes, none of which is scored on; goes on where it stopped.

    With --holdout it is the papers' protocol instead: all scored scenes but one, the one to score.

    Examples:

      rlbench train --methods ours,ntas

      rlbench train -m ours --minutes 30 --device cuda

      rlbench train -m ours --seeds 0:48

      rlbench train -m ntas --holdout hall --preset standard
    """
    _use(plugin)
    from rlbench import registry, show, trainset
    from rlbench.training import Plan
    from rlbench.training import train as fit

    names = registry.expand(asked.split(methods))
    learning = [name for name in names if registry.learns(name)]
    for name in set(names) - set(learning):
        typer.echo(f"{name} has nothing to train")
    chosen = trainset.chosen(preset, asked.seeds(seeds), holdout) if learning else trainset.NONE
    plan = Plan(frames=frames, batch=batch, crop=crop, seed=seed, half=half)
    command = shlex.join(["rlbench", *sys.argv[1:]])
    for name in learning:
        place = out / (name.replace("/", "-") + (f"-without-{holdout}" if holdout else ""))
        with show.training(name, frames) as tell:
            fit(
                name,
                chosen.train,
                chosen.validate,
                place,
                plan,
                str(asked.device(device)),
                minutes,
                command,
                tell,
            )
        typer.echo(f"{name}: {place}")


@app.command()
def check(
    methods: Annotated[list[str], typer.Argument(help="names a,b; family/*; all with variants")],
    plugin: Plugins = None,
    device: Device = "cpu",
) -> None:
    """Check that a method does what every method must, on a world whose truth is known.

    A tick list: what holds, what fails and what would do, and what does not apply (-). Weights are
    random, so nothing is said of quality. Exit code 1 if a claim fails.

    Examples:

      rlbench check ours

      rlbench check bright --plugin bright.py

      rlbench check all
    """
    _use(plugin)
    from rlbench.check.tell import check as examine

    raise typer.Exit(0 if examine(asked.split(methods), asked.device(device)) else 1)


@app.command()
def report(
    name: Annotated[str, typer.Argument(help="a report's name, or all")] = "all",
    results: Results = Path("results"),
    out: Annotated[Path, typer.Option(help="folder to write to")] = Path("results/report"),
) -> None:
    """Write reports from a results table; of all, those that can be written, and why others not.

    Examples:

      rlbench report all

      rlbench report pareto --results results/ --out figures/
    """
    from rlbench import registry, table

    rows, failed = table.read(results), []
    for each in registry.names("reports") if name == "all" else [name]:
        try:
            for file in registry.load("reports", each)(rows, out):
                typer.echo(file)
        except Exception as error:
            if not _expected(error):
                raise
            failed.append(f"{each} was not written: {error}")
    if failed:
        raise asked.AskedError("; ".join(failed))


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
    from rlbench import regress as gate
    from rlbench import table

    wanted = asked.split(only or [])
    if update and wanted:
        raise asked.AskedError("--update writes the whole baseline anew; run it without --only")
    rows = table.read(results)
    rows = rows[rows["method"].isin(wanted)] if wanted else rows
    if update:
        written = gate.update(rows, baseline)
        typer.echo(f"{baseline}: {len(written.entries)} entries")
        return
    outcome = gate.compare(rows, gate.load(baseline), subset=bool(wanted))
    typer.echo(outcome.text())
    raise typer.Exit(0 if outcome.passed else 1)


@app.command()
def doctor(plugin: Plugins = None) -> None:
    """Say what this machine has, what it lacks, and what would help.

    Examples:

      rlbench doctor
    """
    _use(plugin)
    from rlbench import show
    from rlbench.doctor import examine

    show.findings(examine())


def _expected(error: Exception) -> bool:
    """Is it of our own types, so that its message says all there is to say?"""
    return type(error).__module__.partition(".")[0] in OURS


def _use(plugins: list[Path] | None) -> None:
    from rlbench import registry

    for path in plugins or []:
        registry.use_plugin(path)

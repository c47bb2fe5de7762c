"""The commands that train methods, and that check them."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from rlbench import asked
from rlbench.cli_clips import Seeds

Methods = Annotated[
    list[str], typer.Option("--methods", "-m", help="names a,b; all; family/*; may be repeated")
]
Plugins = Annotated[
    list[Path] | None, typer.Option("--plugin", help="a Python file with FAMILY or METHODS")
]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda, or a torch device")]


def use(plugins: list[Path] | None) -> None:
    """Make the plugins of loose files known."""
    from rlbench import registry

    for path in plugins or []:
        registry.use_plugin(path)


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
    use(plugin)
    from rlbench import registry, show, trainset
    from rlbench.training import Plan
    from rlbench.training import train as fit

    names = registry.expand(asked.split(methods))
    learning = [name for name in names if registry.learns(name)]
    for name in set(names) - set(learning):
        typer.echo(f"{name} has nothing to train")
    kinds = {registry.variant(name).traits.pool for name in learning}
    chosen = trainset.NONE
    if learning:
        chosen = trainset.chosen(preset, asked.seeds(seeds), holdout, kinds)
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
    use(plugin)
    from rlbench.check.tell import check as examine

    raise typer.Exit(0 if examine(asked.split(methods), asked.device(device)) else 1)

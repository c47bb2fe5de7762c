"""A queue of trainings on the command line: options of its file, status, pause."""

from __future__ import annotations

import math
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

import typer

from rlbench.cli.methods import load_plugins, trainable_methods
from rlbench.cli.options import DEFAULT_FRAMES
from rlbench.cli.train import QUICK_FRAMES
from rlbench.errors import OptionError
from rlbench.system.paths import check_writable
from rlbench.system.progress import format_duration
from rlbench.training import queue
from rlbench.training.queue import Entry, QueueError, RowStatus, Training
from rlbench.training.run_folder import QUICK, run_folder

# options of the command that belong to the whole queue, or would do the same again in each call
OF_THE_QUEUE = ("methods", "queue", "status", "pause", "out", "minutes", "restart", "help")
LOG_WIDTH = 160  # columns of the status where it is not written to a terminal


def has_options(context: typer.Context) -> bool:
    """True if a command has options of a queue. Raises OptionError for some without --queue."""
    status, pause = context.params["status"], context.params["pause"]
    if context.params["queue"] is None and (status or pause is not None):
        option = "--status" if status else "--pause" if pause else "--unpause"
        raise OptionError(f"{option} is of a queue of trainings. Name its file with --queue")
    return context.params["queue"] is not None


def run_command(context: typer.Context) -> None:
    """Run the queue of --queue in the folder --out, or show, stop or continue the one that runs.

    Options of a training that are given on the command line replace those of the file. The exit
    code is 1 if a training has failed. Raises QueueError for a mistake in the file, before anything
    starts.
    """
    out, pause, minutes = (context.params[name] for name in ("out", "pause", "minutes"))
    if pause is not None:
        queue.set_paused(out, pause)
        typer.echo(f"the queue in {out} {'is paused' if pause else 'continues'}")
        return
    trainings, at_once = _read_trainings(context)
    if context.params["status"]:
        _print_status(queue.read_status(trainings, out), at_once)
        return
    check_writable(out)
    limit = math.inf if minutes is None else minutes
    status = queue.Queue(trainings, out, at_once, typer.echo).run(limit)
    _print_status(status, at_once)
    if any(row.state == "failed" for row in status):
        raise typer.Exit(1)


def _read_trainings(context: typer.Context) -> tuple[list[Training], int]:
    """The trainings of the file, in its order, and how many of them run at once."""
    file, out = context.params["queue"], context.params["out"]
    known = [p.name or "" for p in context.command.params if p.name not in OF_THE_QUEUE]
    given = {
        name: value
        for name, value in context.params.items()
        if str(context.get_parameter_source(name)).endswith("COMMANDLINE")
    }
    if refused := [name for name in ("methods", "restart") if name in given]:
        raise OptionError(f"--{refused[0]} has no effect with --queue: {file} lists the trainings")
    content = queue.read_queue(file, known)
    given = {name: value for name, value in given.items() if name in known}
    ready: dict[str, Training] = {}
    for entry in content.in_running_order():
        options = {**entry.options, **given}
        if options.get("start") in ready:
            options["start"] = ready[options["start"]].weights
        ready[entry.name] = _prepare(context, f"{file}, '{entry.name}'", entry, options, out)
    trainings = [ready[entry.name] for entry in content.entries]
    has_gpu = any(word.startswith("cuda") for each in trainings for word in each.words)
    return trainings, content.at_once or (1 if has_gpu else os.cpu_count() or 1)


def _prepare(
    context: typer.Context, place: str, entry: Entry, options: Mapping[str, Any], out: Path
) -> Training:
    """The training of an entry, whose options are parsed as on the command line."""
    if entry.name != entry.method:
        out = out / entry.name.replace("/", "-")
    words = ["--methods", entry.method, "--out", str(out)]
    for parameter in context.command.params:  # in one order, whatever that of the file
        if parameter.name in options:
            words += _to_words(place, parameter, options[parameter.name])
    try:
        with context.command.make_context("train", list(words), parent=context.parent) as parsed:
            params = parsed.params
    except typer.BadParameter as error:
        raise QueueError(f"{place}: {error.format_message()}") from error
    load_plugins(params["plugin"])
    if trainable_methods([entry.method]) != [entry.method]:
        raise QueueError(
            f"{place}: '{entry.method}' is a pattern. Write a training for each method"
        )
    quick = params["quick"]
    folder = run_folder(
        out, entry.method, params["holdout"], params["train_spp"], QUICK if quick else ""
    )
    default = QUICK_FRAMES if quick else DEFAULT_FRAMES
    frames = params["frames"] or default
    return Training(entry.name, entry.method, tuple(words), folder, frames, entry.after)


def _to_words(place: str, parameter: Any, value: Any) -> list[str]:
    """An option and its value as words of the command line."""
    option = max(parameter.opts, key=len)
    if parameter.is_flag != isinstance(value, bool):
        kind = "true or false" if parameter.is_flag else "a value"
        raise QueueError(f"{place}: {parameter.name} = {value!r} is not {kind}")
    if parameter.is_flag:
        return [option] if value else parameter.secondary_opts[:1]
    values = value if isinstance(value, list | tuple) else [value]
    if parameter.multiple:
        return [word for each in values for word in (option, str(each))]
    return [option, ",".join(str(each) for each in values)]


def _print_status(status: Sequence[RowStatus], at_once: int) -> None:
    """Print a line for each training, why some failed, and a total."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("training", "state", "frames", "frames/s", "time left", "validation, dB"):
        justify: Literal["left", "right"] = "right" if title[:2] in ("fr", "ti") else "left"
        table.add_column(title, justify=justify, no_wrap=True)
    for row in status:
        is_over = row.state in ("done", "failed")
        left = None if is_over else row.run.seconds_left
        table.add_row(
            row.training.name,
            f"{row.state} for {', '.join(row.waits_for)}" if row.waits_for else row.state,
            f"{row.run.frames_seen} of {row.frames}",
            f"{row.run.speed:.2f}" if row.run.speed else "",
            "" if left is None else format_duration(left),
            ", ".join(f"{name} {psnr:.2f}" for name, psnr in row.run.validation.items()),
            style={"failed": "red", "done": "green"}.get(row.state),
        )
    width = None if sys.stdout.isatty() else LOG_WIDTH
    Console(width=width).print(table)
    for row in status:
        if row.message:
            typer.echo(f"{row.training.name}: {row.message}; see {row.training.output}")
    counts = Counter(row.state for row in status)
    summary = ", ".join(f"{count} {state}" for state, count in counts.items())
    left = _estimate_seconds(status, at_once)
    typer.echo(summary if left is None else f"{summary}; about {format_duration(left)} left")


def _estimate_seconds(status: Sequence[RowStatus], at_once: int) -> float | None:
    """Seconds until all are done; a training of unknown speed counts with the mean of the others.

    None if no speed is known, or if nothing is left.
    """
    speeds = [row.run.speed for row in status if row.run.speed > 0]
    left = [row for row in status if row.state not in ("done", "failed")]
    if not speeds or not left:
        return None
    seconds = [
        max(row.frames - row.run.frames_seen, 0) / (row.run.speed or fmean(speeds)) for row in left
    ]
    return max(sum(seconds) / min(at_once, len(left)), *seconds)

"""A queue of trainings on the command line: options of its file, and its status."""

from __future__ import annotations

import math
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import typer

from rlbench.cli.methods import load_plugins, trainable_methods
from rlbench.cli.options import DEFAULT_FRAMES
from rlbench.cli.train import QUICK_FRAMES
from rlbench.errors import OptionError
from rlbench.system.paths import check_writable
from rlbench.system.progress import format_duration
from rlbench.training import queue
from rlbench.training.queue import Entry, QueueError, State, Training
from rlbench.training.run_folder import QUICK, read_state, run_folder, weights_path

# options of the command that belong to the whole queue, or would do the same again in each call
OF_THE_QUEUE = ("methods", "queue", "status", "out", "minutes", "restart", "help")
LOG_WIDTH = 160  # columns of the status where it is not written to a terminal


def run_command(context: typer.Context) -> None:
    """Run the queue of --queue in the folder --out, or show its status.

    Options of a training that are given on the command line replace those of the file. The exit
    code is 1 if a training has failed. Raises OptionError without --queue, and QueueError for a
    mistake in the file, before anything starts.
    """
    names = ("queue", "out", "minutes", "status")
    file, out, minutes, is_status = (context.params[name] for name in names)
    if file is None:
        raise OptionError("--status is of a queue of trainings. Name its file with --queue")
    trainings, at_once = _read_trainings(context, file, out)
    if not is_status:
        check_writable(out)
        limit = math.inf if minutes is None else minutes
        queue.run_queue(trainings, out, at_once, limit, typer.echo)
    states = _print_status(trainings)
    if "failed" in states and not is_status:
        raise typer.Exit(1)


def _read_trainings(context: typer.Context, file: Path, out: Path) -> tuple[list[Training], int]:
    """The trainings of the file, and how many of them run at once."""
    known = [p.name or "" for p in context.command.params if p.name not in OF_THE_QUEUE]
    given = {
        name: value
        for name, value in context.params.items()
        if str(context.get_parameter_source(name)).endswith("COMMANDLINE")
    }
    if refused := [name for name in ("methods", "restart") if name in given]:
        raise OptionError(f"--{refused[0]} has no effect with --queue: {file} lists the trainings")
    entries, at_once = queue.read_queue(file, known)
    given = {name: value for name, value in given.items() if name in known}
    ready: dict[str, Training] = {}
    for entry in entries:
        options = {**entry.options, **given}
        if (start := str(options.get("start"))) in ready:
            options["start"] = ready[start].weights
        ready[entry.name] = _prepare(context, f"{file}, '{entry.name}'", entry, options, out)
    has_gpu = any(word.startswith("cuda") for each in ready.values() for word in each.words)
    return list(ready.values()), at_once or (1 if has_gpu else os.cpu_count() or 1)


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
    suffix, frames = (QUICK, QUICK_FRAMES) if params["quick"] else ("", DEFAULT_FRAMES)
    folder = run_folder(out, entry.method, params["holdout"], params["train_spp"], suffix)
    weights = weights_path(entry.method, folder)
    return Training(entry.name, tuple(words), weights, params["frames"] or frames, entry.after)


def _to_words(place: str, parameter: Any, value: Any) -> list[str]:
    """An option and its value as words of the command line."""
    option = max(parameter.opts, key=len)
    if parameter.is_flag:
        if not isinstance(value, bool):
            raise QueueError(f"{place}: {parameter.name} = {value!r} is not true or false")
        return [option] if value else parameter.secondary_opts[:1]
    values = value if isinstance(value, list | tuple) else [value]
    if parameter.multiple:
        return [word for each in values for word in (option, str(each))]
    return [option, ",".join(str(each) for each in values)]


def _print_status(trainings: Sequence[Training]) -> Sequence[State]:
    """Print a line for each training, why some failed, and a total; returns their states."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("training", "state", "frames", "frames/s", "time left", "validation, dB"):
        justify: Literal["left", "right"] = "right" if title[:2] in ("fr", "ti") else "left"
        table.add_column(title, justify=justify, no_wrap=True)
    attempts = {training.name: queue.read_attempt(training) for training in trainings}
    for training in trainings:
        state, _ = attempts[training.name]
        first = ", ".join(name for name in training.after if attempts[name][0] != "done")
        run = read_state(training.output.parent)
        is_over = state in ("done", "failed")
        table.add_row(
            training.name,
            f"waiting for {first}" if first and state == "waiting" else state,
            f"{run.frames_seen} of {run.frames or training.frames}",
            f"{run.speed:.2f}" if run.speed else "",
            "" if is_over or run.seconds_left is None else format_duration(run.seconds_left),
            ", ".join(f"{name} {psnr:.2f}" for name, psnr in run.validation.items()),
            style={"failed": "red", "done": "green"}.get(state),
        )
    Console(width=None if sys.stdout.isatty() else LOG_WIDTH).print(table)
    for training in trainings:
        if message := attempts[training.name][1]:
            typer.echo(f"{training.name}: {message}; see {training.output}")
    states = [state for state, _ in attempts.values()]
    typer.echo(", ".join(f"{count} {state}" for state, count in Counter(states).items()))
    return states

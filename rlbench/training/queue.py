"""A queue of trainings: many long ones, each in a process of its own, some of them side by side.

A TOML file lists them. Each entry of `[[training]]` holds options of `rlbench train`, dashes as
underscores; `[queue]` holds `at_once` and defaults of all entries:

    [queue]
    at_once = 2
    frames = 30000
    [[training]]
    method = "ours/paper-A2"
    [[training]]
    method = "ours/paper"
    start = "ours/paper-A2"  # a training of this queue, which then comes first; a file; a row
    after = "nppd"           # starts when that one is finished; one name or a list
    name = "ours/longer"     # default: the method; needed where one method is trained twice

The queue keeps no record. What a training has reached is in its own folder
(`rlbench.training.run_folder`). There `output.log` holds each attempt: its command, what it
printed, and its exit code; and a process that trains holds the lock of this file. So a queue that
was killed goes on where it was. Imports no torch.
"""

from __future__ import annotations

import fcntl
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rlbench.errors import RlbenchError
from rlbench.parallel.executor import TimeLimit
from rlbench.registry.near_names import unknown_name
from rlbench.system import documents
from rlbench.system.folder_lock import locked_folder
from rlbench.system.process_settings import end_with_parent

OUTPUT = "output.log"  # what a training prints
BEGINNING, ENDING = "$ rlbench train ", re.compile(r"(exit code|signal) \d+")  # of an attempt
POLL_S = 0.25
GRACE_MINUTES = 0.5  # in which a training that is stopped may write a checkpoint
OWN_KEYS = ("method", "name", "after")  # of an entry; the others are options of the command
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}

State = Literal["waiting", "running", "done", "failed"]


class QueueError(RlbenchError, ValueError):
    """A queue file with a mistake."""


@dataclass(frozen=True)
class Entry:
    """One training as the file describes it, defaults included."""

    name: str
    method: str
    options: Mapping[str, Any]  # of `rlbench train`, by name with underscores
    after: tuple[str, ...] = ()  # names of entries that come first


@dataclass(frozen=True)
class Training:
    """One training of a queue, ready to start."""

    name: str
    words: tuple[str, ...]  # of the command line behind `rlbench train`
    weights: Path  # that it writes at its end, in the folder of its run
    frames: int
    after: tuple[str, ...] = ()

    @property
    def output(self) -> Path:
        """The file with what the training prints."""
        return self.weights.with_name(OUTPUT)


def read_queue(file: Path, known: Sequence[str]) -> tuple[list[Entry], int | None]:
    """The entries of a queue file, and how many run at once; None where the file does not say.

    The entries have the order of the file, but each is behind those that come before it. `known`
    are the options that an entry may have, with underscores.

    Raises QueueError for a file that is not TOML, an unknown key, two entries with one name, an
    unknown name in `after`, and entries that wait for each other.
    """
    try:
        document = documents.read_toml(file)
    except (OSError, ValueError) as error:
        raise QueueError(f"the queue cannot be read: {error}") from error
    defaults, tables = document.pop("queue", {}), document.pop("training", [])
    if document or not tables or not all(isinstance(table, dict) for table in [defaults, *tables]):
        raise QueueError(
            f"{file} is not a queue: write one table [queue] for defaults, and a table "
            "[[training]] for each training, and nothing else"
        )
    _check_keys(f"{file}, [queue]", defaults, ["at_once", *known])
    at_once = defaults.pop("at_once", None)
    if at_once is not None and (type(at_once) is not int or at_once < 1):
        raise QueueError(f"{file}, [queue]: at_once = {at_once!r} is not a number of processes")
    entries = [
        _read_entry(f"{file}, training {number}", defaults, table, known)
        for number, table in enumerate(tables, 1)
    ]
    return _sort(file, entries), at_once


def _read_entry(
    place: str, defaults: dict[str, Any], table: dict[str, Any], known: Sequence[str]
) -> Entry:
    if not isinstance(method := table.get("method"), str):
        raise QueueError(f"{place}: write its method, such as method = 'ours'")
    _check_keys(f"{place} ({method})", table, [*OWN_KEYS, *known])
    name, after = table.get("name", method), table.get("after", [])
    after = after if isinstance(after, list) else [after]
    if not all(isinstance(text, str) for text in [name, *after]):
        raise QueueError(f"{place} ({method}): name and after are names in quotes")
    options = {key: value for key, value in table.items() if key not in OWN_KEYS}
    return Entry(name, method, defaults | options, tuple(after))


def _check_keys(place: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            raise QueueError(unknown_name(f"{place}: no option '{key}'", key, known))


def _sort(file: Path, entries: Sequence[Entry]) -> list[Entry]:
    """The entries in their order, but each behind those that it starts from or comes after."""
    names = [entry.name for entry in entries]
    if repeated := next((name for name in names if names.count(name) > 1), ""):
        raise QueueError(f"{file}: two trainings are named '{repeated}'. Give one another name = ")
    left, placed = list(map(partial(_link, file, names), entries)), dict[str, Entry]()
    while left:
        entry = next((each for each in left if placed.keys() >= set(each.after)), None)
        if entry is None:
            waiting = ", ".join(each.name for each in left)
            raise QueueError(f"{file}: trainings wait for each other, none can be first: {waiting}")
        left.remove(entry)
        placed[entry.name] = entry
    return list(placed.values())


def _link(file: Path, names: Sequence[str], entry: Entry) -> Entry:
    """The entry, which comes after another that it starts from; itself is its shipped weights."""
    if unknown := next((name for name in entry.after if name not in names), ""):
        problem = f"{file}, training '{entry.name}': no training '{unknown}' to come after"
        raise QueueError(unknown_name(problem, unknown, names))
    start = [name for name in names if name == entry.options.get("start") and name != entry.name]
    return replace(entry, after=tuple(dict.fromkeys([*entry.after, *start])))


def run_queue(
    trainings: Sequence[Training],
    out: Path,
    at_once: int,
    minutes: float = math.inf,
    on_event: Callable[[str], None] = print,
) -> None:
    """Run trainings, at most `at_once` at a time, until none is left, or for some minutes.

    What is done is skipped; what failed is tried again, once in a call. Training processes stop
    with this one, however it ends. They have half a minute to write a checkpoint, unless this
    process was killed. `on_event` gets a line for each
    start and end. Raises FolderInUseError where another queue runs in the folder `out`.
    """
    limit = TimeLimit(minutes)
    running: dict[Training, subprocess.Popen[bytes]] = {}
    with locked_folder(out):
        left = [training for training in trainings if read_attempt(training)[0] != "done"]
        done = {training.name for training in trainings if training not in left}
        try:
            while limit.minutes_left > 0:
                for training in [each for each in running if running[each].poll() is not None]:
                    on_event(_end(training, code := running.pop(training).returncode))
                    if code == 0:
                        done.add(training.name)
                ready = [training for training in left if done.issuperset(training.after)]
                for training in ready[: at_once - len(running)]:
                    left.remove(training)
                    running[training] = _start(training)
                    on_event(f"{training.name}: started; its output is in {training.output}")
                if not running:
                    break
                time.sleep(POLL_S)
        finally:
            _stop(list(running.values()))


def _stop(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """End trainings, after their next checkpoint if that comes soon."""
    for process in processes:
        process.terminate()
    grace = TimeLimit(GRACE_MINUTES)
    for process in processes:
        with suppress(subprocess.TimeoutExpired):
            process.wait(60 * grace.minutes_left)
        if process.poll() is None:  # else its number may be another process's
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _start(training: Training) -> subprocess.Popen[bytes]:
    training.output.parent.mkdir(parents=True, exist_ok=True)
    with training.output.open("a") as output:
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(output, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the process closes it
        output.write(f"\n{BEGINNING}{shlex.join(training.words)}\n")
        output.flush()
        return subprocess.Popen(
            [sys.executable, "-m", "rlbench", "train", *training.words],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | THREADS,
            start_new_session=True,  # Ctrl-C in a terminal reaches the queue alone
            preexec_fn=end_with_parent(),
        )


def _end(training: Training, code: int) -> str:
    """Note how an attempt ended; returns a line about it."""
    with training.output.open("a") as output:
        output.write(f"\nexit code {code}\n" if code >= 0 else f"\nsignal {-code}\n")
    if code == 0:
        return f"{training.name}: done; {training.weights}"
    return f"{training.name}: failed, {read_attempt(training)[1]}"


def read_attempt(training: Training) -> tuple[State, str]:
    """The state of a training after its last attempt, and why that failed.

    A training whose options are others than those of the attempt is waiting.
    """
    text = training.output.read_text(errors="replace") if training.output.exists() else ""
    lines = [line for line in text.rpartition(BEGINNING)[2].splitlines() if line.strip()]
    command, message, ending = lines[:1], lines[-2:-1], "".join(lines[-1:])
    if not ENDING.fullmatch(ending):
        return "running" if _is_locked(training.output) else "waiting", ""
    if command != [shlex.join(training.words)]:
        return "waiting", ""
    if ending == "exit code 0":
        return "done" if training.weights.exists() else "waiting", ""
    return "failed", f"{ending}: {'it printed nothing' if message == command else message[0]}"


def _is_locked(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False

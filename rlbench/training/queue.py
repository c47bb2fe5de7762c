"""A queue of trainings: many long ones, each in a process of its own, on processors that are free.

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

The queue itself keeps one record, `queue.json` in its folder. What a training has reached is in its
own folder (`rlbench.training.run_folder`), so a queue that was killed goes on where it was.
Imports no torch.
"""

from __future__ import annotations

import ctypes
import graphlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rlbench.errors import RlbenchError
from rlbench.parallel.executor import TimeLimit
from rlbench.registry.near_names import unknown_name
from rlbench.system import documents, paths
from rlbench.system.folder_lock import locked_folder
from rlbench.training.run_folder import RunState, read_state, weights_path

RECORD = "queue.json"
PAUSE = "paused"  # a file: while it exists, the queue stops its processes
OUTPUT = "output.log"  # what a training prints
POLL_S = 0.25
PAUSE_TIMEOUT_S, STOP_TIMEOUT_S = 30.0, 20.0
OWN_KEYS = ("method", "name", "after")  # of an entry; the others are options of the command
PR_SET_PDEATHSIG = 1  # linux/prctl.h
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}

LIBC = ctypes.CDLL(None)

State = Literal["waiting", "running", "paused", "done", "failed"]


class QueueError(RlbenchError, ValueError):
    """A queue file with a mistake, or a queue that does not run."""


@dataclass(frozen=True)
class Entry:
    """One training as the file describes it, defaults included."""

    name: str
    method: str
    options: Mapping[str, Any]  # of `rlbench train`, by name with underscores
    after: tuple[str, ...] = ()  # names of entries that come first


@dataclass(frozen=True)
class QueueFile:
    """A queue file."""

    entries: Sequence[Entry]
    at_once: int | None = None  # processes; None where the file does not say

    def in_running_order(self) -> list[Entry]:
        """The entries, each behind those that come before it.

        Raises CycleError where entries wait for each other.
        """
        sorter = graphlib.TopologicalSorter({each.name: each.after for each in self.entries})
        names = list(sorter.static_order())
        return sorted(self.entries, key=lambda entry: names.index(entry.name))


@dataclass(frozen=True)
class Training:
    """One training of a queue, ready to start."""

    name: str
    method: str
    words: tuple[str, ...]  # of the command line behind `rlbench train`
    folder: Path  # of the run
    frames: int
    after: tuple[str, ...] = ()

    @property
    def output(self) -> Path:
        """The file with what the training prints."""
        return self.folder / OUTPUT

    @property
    def weights(self) -> Path:
        """The weights file that the training writes at its end."""
        return weights_path(self.method, self.folder)


@dataclass(frozen=True)
class RowStatus:
    """How far one training of a queue is."""

    training: Training
    state: State
    run: RunState
    message: str = ""  # why it failed
    waits_for: tuple[str, ...] = ()  # trainings that come first

    @property
    def frames(self) -> int:
        """Crops at its end: as its run says, or as planned before that has begun."""
        return self.run.frames or self.training.frames


def read_queue(file: Path, known: Sequence[str]) -> QueueFile:
    """Read a queue file; `known` are the options that an entry may have, with underscores.

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
            f"{file} is no queue: write one table [queue] for defaults, and a table [[training]] "
            "for each training, and nothing else"
        )
    _check_keys(f"{file}, [queue]", defaults, ["at_once", *known])
    at_once = defaults.pop("at_once", None)
    if at_once is not None and (type(at_once) is not int or at_once < 1):
        raise QueueError(f"{file}, [queue]: at_once = {at_once!r} is not a number of processes")
    entries = [_read_entry(file, n, defaults, table, known) for n, table in enumerate(tables, 1)]
    content = QueueFile(_link(file, entries), at_once)
    try:
        content.in_running_order()
    except graphlib.CycleError as error:
        names = " <- ".join(error.args[1])
        raise QueueError(f"{file}: trainings wait for each other: {names}") from error
    return content


def _read_entry(
    file: Path, number: int, defaults: dict[str, Any], table: dict[str, Any], known: Sequence[str]
) -> Entry:
    place = f"{file}, training {number}"
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


def _link(file: Path, entries: Sequence[Entry]) -> list[Entry]:
    """The entries, each of which comes after the one that it starts from."""
    names = [entry.name for entry in entries]
    if repeated := next((name for name in names if names.count(name) > 1), ""):
        raise QueueError(f"{file}: two trainings are named '{repeated}'. Give one another name = ")
    linked = []
    for entry in entries:
        start = entry.options.get("start")
        others = [name for name in names if name != entry.name]  # itself: from shipped weights
        after = dict.fromkeys([*entry.after, *([start] if start in others else [])])
        if unknown := next((name for name in after if name not in names), ""):
            problem = f"{file}, training '{entry.name}': no training '{unknown}' to come after"
            raise QueueError(unknown_name(problem, unknown, names))
        linked.append(Entry(entry.name, entry.method, entry.options, tuple(after)))
    return linked


@dataclass
class Queue:
    """Runs trainings, at most `at_once` at a time, in the folder `out`."""

    trainings: Sequence[Training]
    out: Path
    at_once: int
    on_event: Callable[[str], None] = print  # a line for each start and end
    _rows: dict[str, dict[str, Any]] = field(default_factory=dict)  # what the record says of each
    _processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    _is_paused: bool = False

    def run(self, minutes: float = float("inf")) -> list[RowStatus]:
        """Run until nothing is left, or for some minutes; returns how far each training is.

        A training that failed is not tried again before the next call. Training processes stop
        with this one, however it ends; SIGTERM is as Ctrl-C. Raises FolderInUseError where another
        queue runs in the folder, and KeyboardInterrupt after the processes have stopped.
        """
        limit = TimeLimit(minutes)
        with locked_folder(self.out), _terminate_as_interrupt():
            (self.out / PAUSE).unlink(missing_ok=True)
            rows = _read_record(self.out)["rows"]
            self._rows = {t.name: rows[t.name] for t in self.trainings if _is_done(t, rows)}
            self._write_record()
            try:
                while self._advance() and limit.minutes_left > 0:
                    time.sleep(POLL_S)
            finally:
                self._stop()
        return read_status(self.trainings, self.out)

    def _advance(self) -> bool:
        """Note what has ended, pause or continue, start what can; is anything left to wait for?"""
        for name, process in list(self._processes.items()):
            if process.poll() is not None:
                self._end(name, process.returncode)
        if (self.out / PAUSE).exists() != self._is_paused:
            self._is_paused = not self._is_paused
            self._signal(signal.SIGSTOP if self._is_paused else signal.SIGCONT)
            self._write_record()
            self.on_event("paused" if self._is_paused else "continues")
        ready = [] if self._is_paused else [t for t in self.trainings if self._is_ready(t)]
        for training in ready[: self.at_once - len(self._processes)]:
            self._start(training)
        return bool(self._processes) or self._is_paused

    def _is_ready(self, training: Training) -> bool:
        """May a training start, since it has not in this call, and those before it are done?"""
        done = {name for name, row in self._rows.items() if row["state"] == "done"}
        return training.name not in self._rows and done.issuperset(training.after)

    def _start(self, training: Training) -> None:
        training.folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "rlbench", "train", *training.words]
        parent = os.getpid()
        with training.output.open("ab") as output:
            self._processes[training.name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ | THREADS,
                start_new_session=True,  # Ctrl-C in a terminal reaches the queue alone
                preexec_fn=partial(_become_child, parent),
            )
        self._set_row(training, "running")
        self.on_event(f"{training.name}: started; its output is in {training.output}")

    def _end(self, name: str, code: int) -> None:
        training = next(each for each in self.trainings if each.name == name)
        del self._processes[name]
        if code == 0:
            self._set_row(training, "done")
            self.on_event(f"{name}: done; {training.weights}")
        else:
            message = _last_line(training.output) or "it printed nothing"
            message = f"exit code {code}: {message}" if code > 0 else f"signal {-code}: {message}"
            self._set_row(training, "failed", message)
            self.on_event(f"{name}: failed, {message}")

    def _set_row(self, training: Training, state: State, message: str = "") -> None:
        words = list(training.words)
        self._rows[training.name] = {"state": state, "words": words, "message": message}
        self._write_record()

    def _write_record(self) -> None:
        record = {"process": _identify(os.getpid()), "paused": self._is_paused, "rows": self._rows}
        with paths.atomic_write(self.out / RECORD) as temporary:
            temporary.write_text(json.dumps(record))

    def _signal(self, number: signal.Signals) -> None:
        """Send a signal to all training processes and to theirs."""
        for process in self._processes.values():
            if process.poll() is None:  # else its number may be another process's
                os.killpg(process.pid, number)

    def _stop(self) -> None:
        """Stop the training processes; each keeps its last checkpoint."""
        if self._is_paused:
            self._signal(signal.SIGCONT)
        self._signal(signal.SIGINT)
        for name, process in self._processes.items():
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            del self._rows[name]  # it waits for the next call
        self._processes.clear()
        self._is_paused = False
        self._write_record()


def read_status(trainings: Sequence[Training], out: Path) -> list[RowStatus]:
    """How far each training of a queue is, also while the queue runs in another process."""
    record = _read_record(out)
    rows, works = record["rows"], is_running(out)
    status = []
    for training in trainings:
        row = _row(training, rows)
        state, message = row["state"], row["message"]
        if state == "running":
            state = ("paused" if record["paused"] else "running") if works else "waiting"
        undone = (name for name in training.after if rows.get(name, {}).get("state") != "done")
        waits_for = tuple(undone) if state == "waiting" else ()
        run = read_state(training.folder)
        status.append(RowStatus(training, state, run, message, waits_for))
    return status


def is_running(out: Path) -> bool:
    """True if a queue runs in this folder."""
    process = _read_record(out)["process"]
    return bool(process) and _identify(process[0]) == process


def set_paused(out: Path, is_paused: bool) -> None:
    """Stop all training processes of the queue that runs in `out`, or let them continue.

    Returns when they have stopped. Raises QueueError if no queue runs there, or if it does not
    answer. The queue itself sends the signals, so that no other process can ever receive one.
    """
    if not is_running(out):
        raise QueueError(f"no queue runs in {out}. Name its folder with --out")
    if is_paused:
        (out / PAUSE).touch()
    else:
        (out / PAUSE).unlink(missing_ok=True)
    for _ in range(round(PAUSE_TIMEOUT_S / POLL_S)):
        if _read_record(out)["paused"] == is_paused:
            return
        time.sleep(POLL_S)
    raise QueueError(f"the queue in {out} did not answer in {PAUSE_TIMEOUT_S:g} s")


def _read_record(out: Path) -> dict[str, Any]:
    try:
        record: dict[str, Any] = json.loads((out / RECORD).read_text())
    except FileNotFoundError:
        return {"process": [], "paused": False, "rows": {}}
    except ValueError as error:
        raise QueueError(
            f"{out / RECORD} is damaged ({error}). Delete it: no run is lost"
        ) from error
    return record


def _row(training: Training, rows: Mapping[str, Any]) -> dict[str, Any]:
    """What the record says of a training; one with other options has yet to run."""
    row = rows.get(training.name)
    if row is None or row["words"] != list(training.words):
        return {"state": "waiting", "message": ""}
    return dict(row)


def _is_done(training: Training, rows: Mapping[str, Any]) -> bool:
    return _row(training, rows)["state"] == "done" and training.weights.exists()


def _identify(pid: int) -> list[int]:
    """The number of a process and its start, in clock ticks since boot; empty if it has ended."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return []
    return [pid, int(stat.rpartition(")")[2].split()[19])]  # field 22 of proc(5)


def _last_line(file: Path) -> str:
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - 4096))
        lines = stream.read().decode(errors="replace").splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _become_child(parent: int) -> None:
    """What a new process does before it is a training."""
    _end_with(parent)
    _use_spare_time()


def _end_with(parent: int) -> None:
    """Let this new process end when its parent does, and on SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # shells let background jobs ignore it
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before prctl
        os._exit(1)


def _use_spare_time() -> None:
    """Let this new process run when no other one wants the processor.

    Linux shares processors among sessions first (`sched(7)`, autogroups), so nice values alone
    would give a training as much as everything in another terminal.
    """
    os.nice(19)
    with suppress(OSError):  # not every kernel has these
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text("19")


@contextmanager
def _terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM raises KeyboardInterrupt, as Ctrl-C does."""
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)

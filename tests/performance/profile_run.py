"""Where the time of `rlbench run` goes: tracing, methods, metrics, and the suite itself.

    python -m tests.performance.profile_run overhead.md --out results/overhead

runs `rlbench run --out results/overhead` in this process and writes the page overhead.md: seconds
by stage, and the shares of metrics and of the suite itself. Without --methods the rows are those of
`make demo`. Use an empty results folder, or nothing is measured. Stages exclude one another: a
stage inside another is taken off the outer one. Processor time is less disturbed by other programs
than wall time, and counts all threads of this process.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

Clock = Callable[[], float]


class Stage(NamedTuple):
    """A part of a run: the functions that it consists of, and whose time it is."""

    name: str
    owner: str  # tracing, methods, metrics, or suite
    functions: tuple[tuple[str, str], ...] = ()  # modules, and names in them


PYTORCH = Stage("importing PyTorch", "methods")  # and metrics, which share it
STAGES = (
    Stage("tracing scattered samples", "tracing", (
        ("rlbench.apps.render.jobs.live_pool", "scatter_factor"),
        ("rlbench.apps.render.jobs.live_pool", "open_wavefronts"),
    )),
    Stage("building methods", "methods", (("rlbench.benchmark.run_plan", "build_method"),)),
    Stage("timing methods", "methods", (
        ("rlbench.benchmark.timing", "TimingCache.__call__"),
        ("rlbench.benchmark.timing", "ScatterMeter._counts"),
    )),
    Stage("frames of methods", "methods", (("rlbench.benchmark.runner", "run_clip"),)),
    Stage("metrics", "metrics", (
        ("rlbench.benchmark.scoring", "compare_frame"),
        ("rlbench.benchmark.scoring", "score_frame"),
    )),
    Stage("reading clips", "suite", (
        ("rlbench.clips.stored", "StoredClip.frame"),
        ("rlbench.clips.stored", "StoredClip._half_reference"),
        ("rlbench.benchmark.clip_sources", "open_clip"),
        ("rlbench.benchmark.planning", "select_clips"),
    )),
    Stage("hashes of content", "suite", (("rlbench.benchmark.content_hash", "CellIds.cell_id"),)),
    Stage("reading and writing results", "suite", (
        ("rlbench.benchmark.runner", "CellStore.__init__"),
        ("rlbench.benchmark.runner", "CellStore.write"),
        ("rlbench.benchmark.run_outcome", "read_outcome"),
    )),
)  # fmt: skip
REST = Stage("everything else, with imports", "suite")


class StageClock:
    """Seconds of each stage, without those of the stages inside it."""

    def __init__(self, clock: Clock) -> None:
        """Start in the stage REST."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._clock, self._running, self._since = clock, [REST.name], clock()

    @contextmanager
    def running(self, stage: str) -> Iterator[None]:
        """Count the time of a block for a stage."""
        self._count()
        self._running.append(stage)
        try:
            yield
        finally:
            self._count()
            self._running.pop()

    def stop(self) -> None:
        """Count the time until now."""
        self._count()

    def _count(self) -> None:
        now = self._clock()
        self.seconds[self._running[-1]] += now - self._since
        self._since = now


def profile(words: list[str]) -> list[StageClock]:
    """Run `rlbench run` with these words; the stages by wall and by processor time."""
    clocks = [StageClock(time.perf_counter), StageClock(time.process_time)]
    with clocks[0].running(PYTORCH.name), clocks[1].running(PYTORCH.name):
        import torch  # noqa: F401
    from rlbench.cli.app import app

    for stage in STAGES:
        for module, name in stage.functions:
            _count_function(module, name, stage.name, clocks)
    try:
        app(["run", *words], standalone_mode=False)
    finally:
        for clock in clocks:
            clock.stop()
    return clocks


def _count_function(module: str, name: str, stage: str, clocks: list[StageClock]) -> None:
    """Replace a function or method by one that counts its time, also of a generator's steps."""
    import importlib

    holder: Any = importlib.import_module(module)
    *path, last = name.split(".")
    for part in path:
        holder = getattr(holder, part)
    function = getattr(holder, last)

    @wraps(function)
    def counted(*args: Any, **options: Any) -> Any:
        with clocks[0].running(stage), clocks[1].running(stage):
            value = function(*args, **options)
        return steps(value) if isinstance(value, Iterator) else value

    def steps(values: Iterator[Any]) -> Iterator[Any]:
        while True:
            with clocks[0].running(stage), clocks[1].running(stage):
                try:
                    value = next(values)
                except StopIteration:
                    return
            yield value

    setattr(holder, last, counted)


AIMS = {  # owner: line of the table, and the largest share of the wall time that is asked for
    "metrics": ("**scoring**", "5 %"),
    "suite": ("**suite**, that is neither tracing, nor methods, nor metrics", "5 %"),
}


def table(clocks: list[StageClock]) -> str:
    """The stages as Markdown, and the shares of metrics and of the suite."""
    lines = [
        "| stage | of | wall s | share | processor s | share | aim |",
        "| --- | --- |" + " ---: |" * 5,
    ]
    stages = (PYTORCH, *STAGES, REST)
    lines += [_line(stage.name, stage.owner, "", clocks, [stage.name]) for stage in stages]
    for owner, (name, aim) in AIMS.items():
        parts = [stage.name for stage in stages if stage.owner == owner]
        lines.append(_line(name, "", aim, clocks, parts))
    return "\n".join(lines)


def _line(name: str, owner: str, aim: str, clocks: list[StageClock], stages: list[str]) -> str:
    """Seconds of some stages together by both clocks, and their shares of all."""
    cells = []
    for clock in clocks:
        seconds = sum(clock.seconds[stage] for stage in stages)
        cells += [f"{seconds:.2f}", f"{100 * seconds / sum(clock.seconds.values()):.1f} %"]
    return f"| {name} | {owner} | {' | '.join(cells)} | {aim} |"


def page(words: list[str]) -> str:
    """Run `rlbench run` with these words; what took how long, on which machine."""
    load = os.getloadavg()[0]
    clocks = profile(words)
    from torch import get_num_threads

    from rlbench.system import provenance

    command = shlex.join(["rlbench", "run", *words])
    return (
        f"# Where the time of a run goes\n\n`{command}`, {provenance.machine().name}, "
        f"{get_num_threads()} threads, load average {load:.1f} at the start. Stages exclude one "
        f"another; processor seconds are of all threads.\n\n{table(clocks)}\n"
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(sys.argv[2:]), encoding="utf-8")

"""Where the time of `rlbench run` goes: tracing, methods, metrics, and the suite itself.

    python -m tests.performance.profile_run -m mean,svgf --scenes city --spp 1 --out /tmp/profile

runs the command in this process and prints seconds by stage. Stages exclude one another: a stage
inside another is taken off the outer one. Processor time is less disturbed by other programs than
wall time, and counts all threads of this process.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
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
        ("rlbench.render.jobs.scatter", "scatter_factor"),
        ("rlbench.render.jobs.live_pool", "open_wavefronts"),
    )),
    Stage("building methods", "methods", (("rlbench.benchmark.cell_loader", "CellLoader._build"),)),
    Stage("timing methods", "methods", (
        ("rlbench.benchmark.timing_cache", "TimingCache.__call__"),
        ("rlbench.benchmark.scatter", "ScatterMeter._counts"),
    )),
    Stage("frames of methods", "methods", (("rlbench.benchmark.cell_runner", "run_clip"),)),
    Stage("metrics", "metrics", (
        ("rlbench.benchmark.scoring", "compare_frame"),
        ("rlbench.benchmark.scoring", "score_frame"),
    )),
    Stage("reading clips", "suite", (
        ("rlbench.clips.stored", "StoredClip.frame"),
        ("rlbench.clips.stored", "StoredClip._half_reference"),
        ("rlbench.benchmark.clip_sources", "open_clip"),
        ("rlbench.benchmark.api", "select_clips"),
    )),
    Stage("hashes of content", "suite", (("rlbench.benchmark.cell_ids", "CellIds.cell_id"),)),
    Stage("reading and writing results", "suite", (
        ("rlbench.benchmark.cell_store", "CellStore.__init__"),
        ("rlbench.benchmark.cell_store", "CellStore.write"),
        ("rlbench.benchmark.run_table", "read_outcome"),
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


def table(clocks: list[StageClock]) -> str:
    """The stages as Markdown, and the share of the suite."""
    wall, processor = clocks
    lines = [
        "| stage | of | wall s | share | processor s | share |",
        "| --- | --- |" + " ---: |" * 4,
    ]
    totals = [sum(clock.seconds.values()) for clock in clocks]
    rows = [
        (stage, [clock.seconds[stage.name] for clock in clocks])
        for stage in (PYTORCH, *STAGES, REST)
    ]
    suite = [sum(s[i] for stage, s in rows if stage.owner == "suite") for i in (0, 1)]
    rows.append((Stage("**suite**", "tracing, methods and metrics excluded"), suite))
    for stage, seconds in rows:
        shares = [100 * s / total for s, total in zip(seconds, totals, strict=True)]
        cells = (f"{s:.2f} | {share:.1f} %" for s, share in zip(seconds, shares, strict=True))
        lines.append(f"| {stage.name} | {stage.owner} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table(profile(sys.argv[1:])) + "\n")

"""Pools beside the path tracer's: chains of samples, added to clips that are finished.

A chain remembers what it found in earlier frames, so its frames are traced in order, in one
process. Nothing else of a clip is touched: the pool's files are written one by one, and clip.toml
names the pool when all are there. What was killed goes on where it was: the frames since the last
cut, where all memory is worthless, are traced again for what they leave behind, and only the
missing ones are written.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rich.progress import Progress

from rlbench import registry
from rlbench.clips.frame_files import exr_path, write_pool
from rlbench.clips.header import FILE
from rlbench.clips.stored import Header, read_header, write_header
from rlbench.pools import PoolKind, SampleStreams
from rlbench.render.jobs.frame_worker import SEED
from rlbench.render.jobs.job import POOLS, Job
from rlbench.render.mitsuba import llvm
from rlbench.render.mitsuba.pool_stage import PoolStage
from rlbench.render.mitsuba.tracer import LANES
from rlbench.render.mitsuba.wavefront import WavefrontTracer
from rlbench.render.scene import Scene
from rlbench.system import paths
from rlbench.system.provenance import machine

TOGETHER = 4  # samples of each pixel in a frame whose time is taken


@dataclass(frozen=True, eq=False)
class MissingPool:
    """A pool that a clip of a preset is to have, and has not, or has of another recipe."""

    job: Job
    kind: PoolKind

    @property
    def folder(self) -> Path:
        """The clip's."""
        return self.job.folder

    @property
    def mark(self) -> str:
        """What the pool's files are traced from; files of another mark do not belong here."""
        return f"{self.job.content_key.strip()}, {self.kind.name} recipe {self.kind.recipe}\n"

    @property
    def missing(self) -> list[int]:
        """Frames that have no file of this pool, of this very scene and recipe."""
        known = self._note.is_file() and self._note.read_text() == self.mark
        frames = range(self.job.preset.frames)
        return [i for i in frames if not (known and self._file(i).is_file())]

    @property
    def there(self) -> bool:
        """Does the clip have the pool, so that there is no lack?"""
        header = self.folder / FILE
        named = header.is_file() and self.kind.name in read_header(self.folder).pools
        return named and not self.missing

    def claim(self) -> None:
        """Say what the pool's files are, after removing those of another mark."""
        header = read_header(self.folder)
        if self.kind.name in header.pools:
            write_header(self.folder, _without(header, self.kind.name))
        if self._note.is_file() and self._note.read_text() == self.mark:
            return
        for index in range(self.job.preset.frames):
            self._file(index).unlink(missing_ok=True)
        with paths.replacing(self._note) as path:
            path.write_text(self.mark)

    def _file(self, index: int) -> Path:
        return exr_path(self.folder, f"pool.{self.kind.name}", index)

    @property
    def _note(self) -> Path:
        return self.folder / f"pool.{self.kind.name}.txt"


def lacking(jobs: Iterable[Job]) -> list[MissingPool]:
    """The pools that finished clips lack and this machine can trace: none without wavefronts."""
    installed = registry.names("pools")
    found = [
        MissingPool(job, registry.load("pools", name))
        for job in jobs
        for name in job.preset.pools
        if name not in POOLS and name in installed and (job.folder / FILE).is_file()
    ]
    found = [lack for lack in found if not lack.there]
    return found if found and not llvm.select_variant().startswith("scalar") else []


def add_all(lacks: Sequence[MissingPool], bar: Progress) -> None:
    """Add pools to clips, one after another."""
    frames = [len(lack.missing) for lack in lacks]
    names = ", ".join(sorted({lack.kind.name for lack in lacks}))
    bar.console.print(f"adding pool {names} to {len(lacks)} clips: {sum(frames)} frames")
    task = bar.add_task("", total=sum(frames))
    for lack in lacks:
        bar.update(task, description=lack.job.name)
        add(lack, lambda: bar.advance(task))
        gc.collect()


def add(lack: MissingPool, traced: Callable[[], None] = lambda: None) -> None:
    """Trace the missing frames of a pool, then name it in clip.toml; `traced` hears of each."""
    lack.claim()
    plan, scene = lack.job.preset, lack.job.scene
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    tracer = WavefrontTracer(scene, *plan.size, SEED, plan.cap / scene.exposure)
    if missing := lack.missing:
        pool = chains(tracer, lack.kind, plan.pool_spp)
        start = max(cut for cut in (0, *scene.cuts) if cut <= missing[0])
        for index in range(start, missing[-1] + 1):
            tracer.set_time(float(index))
            samples = pool()
            if index in missing:
                write_pool(lack.folder, index, lack.kind.name, samples)
                traced()
    header = read_header(lack.folder)
    here = header.device == machine().name
    taken = header.sample_ms * dearer(tracer, lack.kind) if here else math.nan
    write_header(lack.folder, _with(header, lack.kind.name, taken))


def chains(
    tracer: WavefrontTracer, kind: PoolKind, count: int
) -> Callable[[], Float[Array, "s h w 3"]]:
    """`count` chains of a pool, so many at a time as memory is for; called once a frame.

    Samples are capped as the tracer's are.
    """
    make = registry.resolve(kind.factory)
    stage = PoolStage(tracer, kind.name)
    most = max(1, LANES // (tracer.height * tracer.width))
    groups = [range(first, min(first + most, count)) for first in range(0, count, most)]
    parts: list[SampleStreams] = [make(stage, group) for group in groups]
    return lambda: tracer.capped(np.concatenate([part() for part in parts]))


def dearer(tracer: WavefrontTracer, kind: PoolKind) -> float:
    """Time of a sample, shadow rays and all, over that of a path, each of several in one frame.

    Of several, as starting a kernel takes the interpreter's time, which is not the sampler's.
    """
    return tracer.relative_cost(chains(tracer, kind, TOGETHER), TOGETHER)


def trace_ms(scene: Scene, height: int, width: int, pool: str) -> float:
    """Milliseconds of one sample per pixel of a pool: what a path takes, times `dearer`.

    Raises LookupError where this machine cannot trace it.
    """
    kind: Any = registry.load("pools", pool)
    if llvm.select_variant().startswith("scalar"):
        raise LookupError(f"pool '{pool}' is traced with LLVM or CUDA alone: see `rlbench doctor`")
    tracer = WavefrontTracer(scene, height, width)
    return tracer.sample_ms() * dearer(tracer, kind)


def _with(header: Header, pool: str, taken: float) -> Header:
    times = tuple(header.sample_ms_of(each) for each in header.pools)
    return replace(header, pools=(*header.pools, pool), pools_ms=(*times, taken))


def _without(header: Header, pool: str) -> Header:
    pools = tuple(each for each in header.pools if each != pool)
    times = tuple(header.sample_ms_of(each) for each in pools)
    return replace(header, pools=pools, pools_ms=times if len(pools) > 1 else ())

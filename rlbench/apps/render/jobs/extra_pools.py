"""Sample pools other than the path tracer's, such as ReSTIR's, added to finished clips.

Such a pool consists of streams of samples with temporal reuse, so its frames are traced in order,
in one process. Nothing else of the clip changes: the files of the pool are written one by one, and
clip.toml lists the pool when all exist. An interrupted pool resumes at the last cut, where no
history is valid: the frames since then are traced again to restore the history, but only missing
files are written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rich.progress import Progress

from rlbench import registry
from rlbench.apps.render.jobs.job import FRAME_POOLS, SEED, Job
from rlbench.apps.render.mitsuba import load
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import WavefrontTracer
from rlbench.apps.render.mitsuba.tracer import MAX_PATHS
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Scene
from rlbench.clips.frame_files import exr_path, write_pool
from rlbench.clips.header import FILE, Header, read_header, write_header
from rlbench.pools import PoolKind, SampleStreams
from rlbench.system import store
from rlbench.system.provenance import machine

TIMED_SPP = 4  # samples per pixel and frame in a time measurement


@dataclass(frozen=True, eq=False)
class MissingPool:
    """A pool that the preset of a clip lists, and that the clip lacks or has of another version."""

    job: Job
    kind: PoolKind

    @property
    def folder(self) -> Path:
        """The clip folder."""
        return self.job.folder

    @property
    def content_key(self) -> str:
        """Everything the samples depend on; files with another key are traced again."""
        return f"{self.job.content_key.strip()}, {self.kind.name} recipe {self.kind.version}\n"

    @property
    def missing_frames(self) -> list[int]:
        """Frames without a file of this pool, scene and version."""
        is_ours = store.read_text(self._key_file) == self.content_key
        frames = range(read_header(self.folder).frames)
        return [i for i in frames if not (is_ours and self._file(i).is_file())]

    @property
    def is_complete(self) -> bool:
        """True if clip.toml lists the pool, and all its files exist."""
        header = self.folder / FILE
        is_listed = header.is_file() and self.kind.name in read_header(self.folder).pools
        return is_listed and not self.missing_frames

    def claim_files(self) -> None:
        """Remove the pool from clip.toml and files with another content key; write this key."""
        header = read_header(self.folder)
        if self.kind.name in header.pools:
            write_header(self.folder, _without_pool(header, self.kind.name))
        files = map(self._file, range(self.job.preset.frames))
        store.claim(self._key_file, self.content_key, older=files)

    def _file(self, index: int) -> Path:
        return exr_path(self.folder, f"pool.{self.kind.name}", index)

    @property
    def _key_file(self) -> Path:
        return self.folder / f"pool.{self.kind.name}.txt"


def find_missing_pools(jobs: Iterable[Job]) -> list[MissingPool]:
    """The missing pools of finished clips; none if this machine has only the scalar variant."""
    installed = registry.list_plugins("pools")
    candidates = [
        MissingPool(job, registry.load_plugin("pools", name))
        for job in jobs
        for name in job.preset.pools
        if name not in FRAME_POOLS and name in installed and (job.folder / FILE).is_file()
    ]
    missing = [pool for pool in candidates if not pool.is_complete]
    return missing if missing and not select_variant().startswith("scalar") else []


def add_pools(missing: Sequence[MissingPool], bar: Progress) -> None:
    """Add pools to clips, one after another."""
    frames = sum(len(pool.missing_frames) for pool in missing)
    names = ", ".join(sorted({pool.kind.name for pool in missing}))
    bar.console.print(f"adding pool {names} to {len(missing)} clips: {frames} frames")
    task = bar.add_task("", total=frames)
    for pool in missing:
        bar.update(task, description=pool.job.name)
        add_pool(pool, lambda: bar.advance(task))


def add_pool(missing: MissingPool, on_frame: Callable[[], None] = lambda: None) -> None:
    """Trace the missing frames of a pool, then list it in clip.toml; `on_frame` runs after each."""
    missing.claim_files()
    preset, scene, kind = missing.job.preset, missing.job.scene, missing.kind
    tracer = WavefrontTracer(scene, *preset.size, SEED, preset.radiance_cap / scene.exposure)
    if frames := missing.missing_frames:
        trace_frame = open_streams(tracer, kind, preset.pool_spp)
        start = max(cut for cut in (0, *scene.cuts) if cut <= frames[0])
        for index in range(start, frames[-1] + 1):
            tracer.set_time(float(index))
            samples = trace_frame()
            if index in frames:
                write_pool(missing.folder, index, kind.name, samples)
                on_frame()
    header = read_header(missing.folder)
    is_same_machine = header.device == machine().name
    sample_ms = header.sample_ms * relative_cost(tracer, kind) if is_same_machine else math.nan
    write_header(missing.folder, _with_pool(header, kind.name, sample_ms))


def open_streams(
    tracer: WavefrontTracer, kind: PoolKind, count: int
) -> Callable[[], Float[Array, "s h w 3"]]:
    """A function that traces the next frame of `count` streams of a pool; call it once per frame.

    Streams run in groups that fit into memory. The tracer's radiance cap applies.
    """
    make_streams = registry.resolve(kind.factory)
    stage = PoolStage(tracer, kind.name)
    group = max(1, MAX_PATHS // (tracer.height * tracer.width))
    ranges = [range(first, min(first + group, count)) for first in range(0, count, group)]
    streams: list[SampleStreams] = [make_streams(stage, numbers) for numbers in ranges]
    return lambda: tracer.apply_cap(np.concatenate([trace() for trace in streams]))


def relative_cost(tracer: WavefrontTracer, kind: PoolKind) -> float:
    """Time of one sample of a pool, shadow rays included, divided by that of one path.

    Both are measured with several samples per frame, so that the interpreter's time to launch a
    kernel does not count.
    """
    return tracer.relative_cost(open_streams(tracer, kind, TIMED_SPP), TIMED_SPP)


def pool_sample_ms(scene: Scene, height: int, width: int, pool: str) -> float:
    """Milliseconds per frame at one sample per pixel of a pool: a path's time x `relative_cost`.

    Raises LookupError if this machine cannot trace the pool.
    """
    kind: PoolKind = registry.load_plugin("pools", pool)
    if select_variant().startswith("scalar"):
        raise LookupError(
            f"pool '{pool}' needs LLVM or CUDA, and this machine has neither: run `rlbench doctor`"
        )
    tracer = WavefrontTracer(scene, height, width)
    return tracer.measure_sample_ms() * relative_cost(tracer, kind)


def _with_pool(header: Header, pool: str, sample_ms: float) -> Header:
    times = tuple(header.sample_ms_of(name) for name in header.pools)
    return replace(header, pools=(*header.pools, pool), pools_ms=(*times, sample_ms))


def _without_pool(header: Header, pool: str) -> Header:
    pools = tuple(name for name in header.pools if name != pool)
    times = tuple(header.sample_ms_of(name) for name in pools)
    return replace(header, pools=pools, pools_ms=times if len(pools) > 1 else ())


@dataclass
class PoolStage:
    """A scene at the tracer's current time; implements `rlbench.pools.RenderContext`."""

    tracer: WavefrontTracer
    stream: str  # of random numbers
    _motion: tuple[float, Any, Any] | None = field(default=None, repr=False)

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.tracer.height

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.tracer.width

    @property
    def scene(self) -> Any:
        """The Mitsuba scene at the current time."""
        return self.tracer.mi_scene

    @property
    def max_depth(self) -> int:
        """Longest light path, in edges."""
        return self.tracer.scene.max_depth

    def camera_rays(self, x: Any, y: Any) -> Any:
        """The camera rays through film positions in pixels (mi.Float)."""
        return self.tracer.rays(x, y)

    def sampler(self, pixels: Any, samples: Any) -> Any:
        """A sampler whose lanes are pixels and samples (mi.UInt32)."""
        return self.tracer.make_sampler(pixels, samples, self.stream)

    def motion(self) -> tuple[Any, Any]:
        """Motion vectors x and y of every pixel (mi.Float): pixels to the previous position."""
        import mitsuba as mi

        if self._motion is None or self._motion[0] != self.tracer.time:
            motion = np.zeros((self.height, self.width, 2), np.float32)
            if not self.tracer.scene.static:
                motion = render_gbuffer(self.tracer, ("motion",))["motion"]
            x, y = (load.upload(mi.Float, motion[..., axis]) for axis in range(2))
            self._motion = self.tracer.time, x, y
        return self._motion[1:]

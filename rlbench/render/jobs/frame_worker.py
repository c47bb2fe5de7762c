"""Traces single frames on any worker; the process that started the job writes them to disk."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.stored import write_frame
from rlbench.parallel.executor import ProgressCallback, Resources
from rlbench.render.jobs import references
from rlbench.render.jobs.job import Job
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import Tracer, open_tracer
from rlbench.render.mitsuba.variant import select_variant

__all__ = ["SEED", "FrameBuffers", "FrameRenderer", "FrameTask", "frame_resources", "save_frame"]

SEED = 0  # of all light paths; frames, samples and streams have keys of their own
CPUS = 4  # per frame; more are of little use, as G-buffers and textures are made by one


@dataclass(frozen=True)
class FrameTask:
    """One frame to trace."""

    clip_index: int  # into `FrameRenderer.jobs`
    frame: int


class FrameBuffers(NamedTuple):
    """A traced frame: linear radiance, before exposure."""

    gbuffer: dict[str, Any]  # [h w c], by buffer name
    pool: Float[Array, "s h w 3"]  # independent 1-spp images
    half_a: Float[Array, "h w 3"]  # of the reference
    half_b: Float[Array, "h w 3"]
    reference_spp: int  # samples per pixel of both halves together


@dataclass
class FrameRenderer:
    """Traces frames of several clips. The last scene stays open, as opening takes seconds."""

    jobs: Sequence[Job]
    _open: tuple[int, Tracer] | None = None

    def __call__(self, task: FrameTask, on_progress: ProgressCallback) -> FrameBuffers:
        """Trace one frame; `on_progress` receives the light paths of each launch."""
        job, tracer = self.jobs[task.clip_index], self.open_clip_scene(task.clip_index)
        height, width = job.preset.size

        def on_samples(spp: int) -> None:
            on_progress(spp * height * width)

        tracer.set_time(float(task.frame))
        gbuffer = render_gbuffer(tracer, job.buffers)
        pool = tracer.trace_images(job.preset.pool_spp)
        on_samples(job.preset.pool_spp)
        return FrameBuffers(
            gbuffer,
            pool,
            *references.trace_reference(tracer, job.preset, job.scene.exposure, on_samples),
        )

    def open_clip_scene(self, clip_index: int) -> Tracer:
        """The tracer of a clip's scene; the scene opened before is closed."""
        if self._open is None or self._open[0] != clip_index:
            self._open = None
            gc.collect()  # while the old scene is alive, Dr.Jit compiles kernels for the next again
            job = self.jobs[clip_index]
            cap = job.preset.radiance_cap / job.scene.exposure
            self._open = clip_index, open_tracer(job.scene, *job.preset.size, SEED, cap)
        return self._open[1]


def frame_resources() -> Resources:
    """Resources of one frame: a few CPU cores, or one GPU."""
    return Resources(CPUS, gpus=1 if select_variant().startswith("cuda") else 0)


def save_frame(job: Job, index: int, frame: FrameBuffers) -> None:
    """Write a frame to the folder of its clip; each file is complete or absent."""
    if job.preset.max_reference_rounds > 1:
        references.write_spp(job.folder, index, frame.reference_spp)
    write_frame(job.folder, index, frame.gbuffer, {"path": frame.pool}, frame.half_a, frame.half_b)

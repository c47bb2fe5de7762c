"""Tracing one frame of one of several clips, wherever that may be, and keeping it here."""

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
from rlbench.render.mitsuba import llvm
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import Tracer, open_tracer

SEED = 0  # of the light paths; frames, samples and streams are told apart below it
CPUS = 4  # that a frame may use: more gain little, as views and textures are made by one


@dataclass(frozen=True)
class FrameTask:
    """One frame to be traced."""

    clip: int  # its place among the studio's clips
    index: int  # of the frame


class FrameBuffers(NamedTuple):
    """One frame as traced: linear radiance, before exposure."""

    gbuffer: dict[str, Any]  # buffers by name, h w c
    pool: Float[Array, "s h w 3"]  # independent 1-spp images
    half_a: Float[Array, "h w 3"]  # one half of the reference
    half_b: Float[Array, "h w 3"]  # the other
    spp: int  # that both halves cost


@dataclass
class FrameRenderer:
    """Traces frames of clips. The scene of the last one stays open, as opening takes seconds."""

    jobs: Sequence[Job]
    _open: tuple[int, Tracer] | None = None

    def __call__(self, shot: FrameTask, tell: ProgressCallback) -> FrameBuffers:
        """The frame; `tell` hears of light paths as they are done."""
        job, tracer = self.jobs[shot.clip], self.tracer(shot.clip)
        height, width = job.preset.size

        def traced(spp: int) -> None:
            tell(spp * height * width)

        tracer.set_time(float(shot.index))
        gbuffer = render_gbuffer(tracer, job.buffers)
        pool = tracer.stack(job.preset.pool_spp)
        traced(job.preset.pool_spp)
        return FrameBuffers(
            gbuffer,
            pool,
            *references.trace_reference(tracer, job.preset, job.scene.exposure, traced),
        )

    def tracer(self, clip: int) -> Tracer:
        """The tracer of a clip's scene, in place of the one before."""
        if self._open is None or self._open[0] != clip:
            self._open = None
            gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
            job = self.jobs[clip]
            cap = job.preset.cap / job.scene.exposure
            self._open = clip, open_tracer(job.scene, *job.preset.size, SEED, cap)
        return self._open[1]


def share() -> Resources:
    """What a frame takes of a machine: some processors, or a GPU."""
    return Resources(CPUS, gpus=1 if llvm.select_variant().startswith("cuda") else 0)


def keep(job: Job, index: int, frame: FrameBuffers) -> None:
    """Write a frame to its clip's folder, each file whole or not at all."""
    if job.preset.max_reference_rounds > 1:
        references.note(job.folder, index, frame.spp)
    write_frame(job.folder, index, frame.gbuffer, {"path": frame.pool}, frame.half_a, frame.half_b)

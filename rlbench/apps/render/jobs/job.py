"""A render job: one clip, which of its frames are missing, and how one of them is traced.

The process that started the job writes the frames to disk, wherever they are traced.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.jobs import references
from rlbench.apps.render.jobs.references import SPP_FILES, read_spp, stored_noise_ceiling_db
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import describe_tracer, open_tracer
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Scene
from rlbench.clips.frame_files import has_frame, write_frame
from rlbench.clips.header import FILE, ClipError, Header, names_in_digests, read_header
from rlbench.clips.presets import Preset
from rlbench.frames import BUFFERS
from rlbench.parallel.executor import ProgressCallback, Resources
from rlbench.system import load, paths, store
from rlbench.system.provenance import machine

FRAME_POOLS = ("path",)  # pools that are traced with each frame; others are added to finished clips
CONTENT_KEY_FILE = "scene.txt"  # beside the frames
REPEATS = 9  # frames at one sample per pixel, of which times are taken
GBUFFER_REPEATS = 3
SEED = 0  # of all light paths; frames, samples and streams have keys of their own
CPUS = 4  # per frame; more are of little use, as G-buffers and textures are made by one


@dataclass(frozen=True, eq=False)
class Job:
    """One clip to render into a folder, or the first frames of it, which are equal bit for bit.

    A clip of first frames is a valid one, as its header has their number; a job without a limit
    renders the others later.
    """

    name: str
    scene: Scene
    preset: Preset
    folder: Path
    limit_frames: int | None = None  # that are rendered at most, the first ones

    @property
    def frames(self) -> int:
        """Number of frames to render."""
        return min(self.limit_frames or self.preset.frames, self.preset.frames)

    @property
    def buffers(self) -> tuple[str, ...]:
        """The G-buffer channels to write; a static scene has no motion."""
        names = (*BUFFERS, *self.preset.extra_buffers)
        return tuple(b for b in names if not (self.scene.static and b == "motion"))

    @property
    def missing_frames(self) -> list[int]:
        """Frames whose files are incomplete or were rendered with another content key."""
        is_ours = read_content_key(self.folder) == self.content_key
        return [i for i in range(self.frames) if not (is_ours and self._is_complete(i))]

    def _is_complete(self, index: int) -> bool:
        return has_frame(self.folder, index, FRAME_POOLS) and self.reference_spp(index) > 0

    def reference_spp(self, index: int) -> int:
        """Samples per pixel of a frame's reference, both halves together; 0 if unknown."""
        if self.preset.max_reference_rounds == 1:
            return 2 * self.preset.reference_spp
        return read_spp(self.folder, index) or 0

    @cached_property
    def content_key(self) -> str:
        """Everything the pixels depend on, as one line of text.

        Frames that were rendered with another key are rendered again.
        """
        preset = self.preset
        samples = f"{preset.pool_spp} + 2 x {preset.reference_spp} spp"
        size = "x".join(map(str, preset.size))
        samples += (
            f", up to {preset.max_reference_rounds} rounds to {preset.min_noise_ceiling_db:g} dB"
        ) * (preset.max_reference_rounds > 1)
        samples += f", cap {preset.radiance_cap:g}" * (preset.radiance_cap < math.inf)
        samples += f", with {' '.join(names_in_digests(preset.extra_buffers))}" * bool(
            preset.extra_buffers
        )
        return f"{fingerprint(self.scene, preset.frames)} {size} {preset.frames} frames {samples}\n"

    def inspect(self) -> Job:
        """The job with its scene as it is rendered; see `Scene.inspect`."""
        return replace(self, scene=self.scene.inspect(self.preset.frames, self.preset.size))

    @property
    def is_finished(self) -> bool:
        """True if the folder holds all frames with this content key, and a header of as many."""
        if not (self.folder / FILE).is_file() or self.missing_frames:
            return False
        return read_header(self.folder).frames >= self.frames

    def make_header(
        self,
        sampler: str,
        version: str,
        sample_ms: float,
        seed: int = 0,
        stratified: bool = False,
    ) -> Header:
        """The header of the clip, whose frames must all be on disk.

        The tracer provides the arguments: its name, version, milliseconds per sample (nan if
        unknown), seed, and whether the samples of a reference half are stratified together.
        """
        preset, scene = self.preset, self.scene
        return Header(
            name=self.name,
            scene=scene.name,
            preset=preset.name,
            sampler=sampler,
            sampler_version=version,
            height=preset.size[0],
            width=preset.size[1],
            frames=self.frames,
            seed=seed,
            exposure=scene.exposure,
            pool_spp=preset.pool_spp,
            radiance_cap=preset.radiance_cap,
            reference_spp=tuple(map(self.reference_spp, range(self.frames))),
            stratified=stratified,
            noise_ceiling_db=tuple(
                stored_noise_ceiling_db(self.folder, index, *preset.size, scene.exposure)
                for index in range(self.frames)
            ),
            buffers=self.buffers,
            pools=FRAME_POOLS,
            static=scene.static,
            missing_files=scene.missing_files,
            cuts=tuple(cut for cut in scene.cuts if cut < self.frames),
            light_changes=scene.light_changes(self.frames),
            licence=scene.licence,
            sample_ms=sample_ms,
            device=machine().name,
        )

    def claim_folder(self) -> None:
        """Remove frames with another content key from the folder and write this job's key.

        Raises ClipError if the folder holds frames without any key, which `rlbench render` did not
        write and must not delete.
        """
        paths.remove_temporaries(self.folder)
        files = [self.folder / FILE, *self.folder.glob("*.exr"), *self.folder.glob(SPP_FILES)]
        existing = [file for file in files if file.is_file()]
        if existing and not read_content_key(self.folder):
            raise ClipError(
                f"{self.folder} holds frames that `rlbench render` did not write; "
                "move that folder, or render into another one"
            )
        store.claim(self.folder / CONTENT_KEY_FILE, self.content_key, older=existing)


def read_content_key(folder: Path) -> str:
    """The content key of the frames in a folder; empty if `rlbench render` did not write them."""
    return store.read_text(folder / CONTENT_KEY_FILE)


def read_whole_length(folder: Path) -> int | None:
    """Frames of the whole clip, of which a folder may hold the first ones; None if not known.

    Camera paths and exposures depend on it.
    """
    found = re.match(r"\S+ \S+ (\d+) frames", read_content_key(folder))
    return int(found[1]) if found else None


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


class TraceTimes(NamedTuple):
    """Milliseconds of a full frame at one sample per pixel, and of a G-buffer."""

    sample_p5_ms: float  # on a busy machine, the low end of an estimate
    sample_ms: float  # the median; on a busy machine an estimate, see `rlbench.system.load`
    sample_p95_ms: float
    gbuffer_ms: float  # of the four standard buffers
    timed_with: str  # tracer variant and threads

    def written_to(self, header: Header) -> Header:
        """The header with these times."""
        return replace(header, **self._asdict())


def measure_trace_times(tracer: Tracer) -> TraceTimes:
    """The times of a tracer on this machine; on a busy one, estimates with a wide interval."""
    ran, waited = load.processor_ms(), load.waiting_ms()
    times = tracer.measure_ms(lambda: tracer.trace_frame(1), REPEATS)
    gbuffers = tracer.measure_ms(lambda: render_gbuffer(tracer), GBUFFER_REPEATS)
    share = load.running_share(load.processor_ms() - ran, load.waiting_ms() - waited)
    low, ms, high = np.percentile(times, [5, 50, 95]).tolist()
    gbuffer_ms = float(np.median(gbuffers))
    if share < load.MIN_PROCESSOR_SHARE:  # false for nan
        ms, low, _ = load.estimate_quiet_ms(times, share)
        gbuffer_ms = load.estimate_quiet_ms(gbuffers, share).ms
    return TraceTimes(low, ms, high, gbuffer_ms, describe_tracer())

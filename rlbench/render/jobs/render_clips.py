"""Rendering what is missing of a preset's clips, frame by frame, resumable at any moment.

Frames are traced by an engine, here or elsewhere, and written here. A clip's header, which says
how long a sample takes, is written when no frame is being traced on this machine any more.
"""

from __future__ import annotations

import gc
import importlib
import importlib.metadata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench import registry
from rlbench.clips.stored import Header, write_header
from rlbench.parallel.executor import LOCAL, Executor, ProgressCallback
from rlbench.render.jobs import extra_pools
from rlbench.render.jobs.frame_worker import SEED, FrameRenderer, FrameTask, keep, share
from rlbench.render.jobs.job import Job
from rlbench.render.mitsuba import llvm
from rlbench.render.mitsuba.open_tracer import Tracer, open_tracer
from rlbench.render.presets import GENERATED, Preset, preset
from rlbench.render.scene import Scene
from rlbench.system import paths

TRIAL = 8  # samples per pixel that are traced to guess how long all of them take
PATIENCE = 3600.0  # seconds of progress that a guess of the rest looks back on, if by whole frames


def ensure(
    chosen: Preset | str,
    scenes: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    engine: Executor = LOCAL,
) -> list[Path]:
    """The clip folders of a preset, after rendering what is missing of them.

    `scenes` and `seeds` of generated scenes replace the preset's own; where only one is given, the
    other is empty. A scene stands for the takes of it that the preset has, `<scene>-<take>` for
    that take alone. Whole frames that are there are kept, unless the scene has changed since.
    `folder` holds the clips, in place of the cache. `progress` shows how far it is, in place of a
    bar of its own, and `engine` traces the frames. Raises LookupError for an unknown preset or
    scene, SceneError for a take.
    """
    chosen = preset(chosen) if isinstance(chosen, str) else chosen
    folder = folder or paths.clips() / chosen.name
    if scenes is None and seeds is None:
        scenes, seeds = chosen.scenes, chosen.seeds
    names = [*(scenes or ()), *(f"{GENERATED}-{seed:03d}" for seed in seeds or ())]
    made: dict[str, Scene] = {}
    for name in names:
        made |= _takes(name, chosen)
    jobs = [Job(name, scene, chosen, folder / name) for name, scene in made.items()]
    return render_missing(jobs, progress, engine)


def render_missing(
    jobs: list[Job], progress: Progress | None = None, engine: Executor = LOCAL
) -> list[Path]:
    """The folders of clips of one preset, after rendering what is missing of them.

    Pools beside the path tracer's come last, here, whatever the engine: their frames hang together.
    """
    if unfinished := [job for job in jobs if not job.finished]:
        with _shown(progress, engine) as bar:
            _render_all(unfinished, bar, engine)
    if lacking := extra_pools.lacking(jobs):
        with _shown(progress, LOCAL) as bar:
            extra_pools.add_all(lacking, bar)
    return [job.folder for job in jobs]


def scene_of_clip(clip: str) -> Scene:
    """The scene of a clip by the clip's name.

    That is `generated-<seed>`, an installed scene, or `<scene>-<take>`. Raises LookupError for an
    unknown scene, and SceneError for an unknown take.
    """
    kind, _, last = clip.rpartition("-")
    if kind == GENERATED and last.isdigit():
        generated: Scene = importlib.import_module("rlbench.scenes.generator.scene").scene(
            int(last)
        )
        return generated

    installed = registry.names("scenes")
    whole = clip in installed or kind not in installed
    scene: Scene = registry.load("scenes", clip if whole else kind)()
    return scene if whole else scene.take(last)


def render(
    job: Job, traced: ProgressCallback = lambda samples: None, engine: Executor = LOCAL
) -> None:
    """Render the missing frames of one clip, then write its header.

    Stored radiance is as traced; `exposure` is in the header. `traced` is told of light paths as
    they are done. Killed at any moment and called again, it leaves the same files. A frame that
    cannot be traced does not stop the others; its error is raised when they are done.
    """
    _raise_first(_together([job], traced, engine))
    for lack in extra_pools.lacking([job]):
        extra_pools.add(lack)


def _takes(name: str, chosen: Preset) -> dict[str, Scene]:
    """The clips, by name, that a scene or a single take stands for in a preset."""
    scene = scene_of_clip(name)
    takes = scene.takes if chosen.takes == "all" else ()
    return {name: scene, **{f"{name}-{take.name}": scene.take(take.name) for take in takes}}


def _together(jobs: list[Job], traced: ProgressCallback, engine: Executor) -> list[Exception]:
    """Render clips, a frame at a time, then write headers; the errors of frames that have none."""
    for job in jobs:
        job.claim()
    studio = FrameRenderer(jobs)
    shots = [FrameTask(clip, index) for clip, job in enumerate(jobs) for index in job.missing]
    errors = []
    for outcome in engine.map(studio, shots, share(), traced):
        if outcome.error:
            errors.append(outcome.error)
        else:
            keep(jobs[outcome.job.clip], outcome.job.index, outcome.result())
    for clip, job in enumerate(jobs):
        if not job.missing:
            write_header(job.folder, _header(job, studio.tracer(clip)))
    return errors


def _render_all(jobs: list[Job], bar: Progress, engine: Executor) -> None:
    area = jobs[0].preset.size[0] * jobs[0].preset.size[1]
    total = sum(len(job.missing) * job.preset.frame_samples for job in jobs)
    trial = open_tracer(jobs[0].scene, *jobs[0].preset.size).sample_ms(repeats=1, spp=TRIAL)
    seconds = total / area * trial / 1e3
    most = "at most " if jobs[0].preset.max_reference_rounds > 1 else ""
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    alone = f" by this machine alone; {engine.where}" if engine.where else ""
    bar.console.print(
        f"rendering {len(jobs)} clips of preset {jobs[0].preset.name} "
        f"with {llvm.select_variant()}: "
        f"{most}{total / 1e6:.0f} million light paths, about {_duration(seconds)}{alone}; "
        f"into {jobs[0].folder.parent}"
    )
    task = bar.add_task("", total=total)
    errors: list[Exception] = []
    for together in [[job] for job in jobs] if engine.exclusive else [jobs]:
        named = together[0].name if len(together) == 1 else f"{len(together)} clips"
        bar.update(task, description=named)
        errors += _together(together, partial(bar.advance, task), engine)
        gc.collect()
    _raise_first(errors)


def _raise_first(errors: list[Exception]) -> None:
    if len(errors) > 1:
        errors[0].add_note(f"and {len(errors) - 1} more, the last of which: {errors[-1]}")
    if errors:
        raise errors[0]


def _header(job: Job, tracer: Tracer) -> Header:
    version = f"{importlib.metadata.version('mitsuba')} {llvm.select_variant()}"
    return job.header("mitsuba path", version, tracer.sample_ms(), seed=SEED)


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


@contextmanager
def _shown(progress: Progress | None, engine: Executor) -> Iterator[Progress]:
    """The caller's bar, or one of its own on standard error."""
    if progress:
        yield progress
        return
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TaskProgressColumn())
    period = 120 if engine.exclusive else PATIENCE
    with Progress(
        *columns, TimeRemainingColumn(), console=Console(stderr=True), speed_estimate_period=period
    ) as bar:
        yield bar

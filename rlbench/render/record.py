"""Rendering what is missing of a preset's clips, frame by frame, resumable at any moment."""

from __future__ import annotations

import gc
import importlib
import importlib.metadata
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench import paths, registry
from rlbench.clips import Header, write_frame, write_header
from rlbench.provenance import machine
from rlbench.render import llvm, rounds
from rlbench.render.job import POOLS, Job
from rlbench.render.presets import GENERATED, Preset, preset
from rlbench.render.scene import Scene
from rlbench.render.trace import Tracer, open_tracer
from rlbench.render.views import views

TRIAL = 8  # samples per pixel that are traced to guess how long all of them take
SEED = 0  # of the light paths; frames, samples and streams are told apart below it


def ensure(
    chosen: Preset | str,
    scenes: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """The clip folders of a preset, after rendering what is missing of them.

    `scenes` and `seeds` of generated scenes replace the preset's own; where only one is given, the
    other is empty. A scene stands for the takes of it that the preset has, `<scene>-<take>` for
    that take alone. Whole frames that are there are kept, unless the scene has changed since.
    `folder` holds the clips, in place of the cache. `progress` shows how far it is, in place of a
    bar of its own. Raises LookupError for an unknown preset or scene, SceneError for a take.
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
    return finish(jobs, progress)


def finish(jobs: list[Job], progress: Progress | None = None) -> list[Path]:
    """The folders of clips of one preset, after rendering what is missing of them."""
    if unfinished := [job for job in jobs if not job.finished]:
        with _shown(progress) as bar:
            _render_all(unfinished, bar)
    return [job.folder for job in jobs]


def named(clip: str) -> Scene:
    """The scene of a clip by the clip's name.

    That is `generated-<seed>`, an installed scene, or `<scene>-<take>`. Raises LookupError for an
    unknown scene, and SceneError for an unknown take.
    """
    kind, _, last = clip.rpartition("-")
    if kind == GENERATED and last.isdigit():
        generated: Scene = importlib.import_module("rlbench.scenes.generator").scene(int(last))
        return generated

    installed = registry.names("scenes")
    whole = clip in installed or kind not in installed
    scene: Scene = registry.load("scenes", clip if whole else kind)()
    return scene if whole else scene.take(last)


def render(job: Job, traced: Callable[[int], None] = lambda samples: None) -> None:
    """Render the missing frames of one clip, then write its header.

    Stored radiance is as traced; `exposure` is in the header. `traced` is told of light paths as
    they are done. Killed at any moment and called again, it leaves the same files.
    """
    height, width = job.preset.size
    job.claim()
    tracer = open_tracer(job.scene, height, width, SEED, job.preset.cap / job.scene.exposure)
    for index in job.missing:
        tracer.set_time(float(index))
        _render_frame(job, tracer, index, lambda spp: traced(spp * height * width))
    write_header(job.folder, _header(job, tracer))


def _takes(name: str, chosen: Preset) -> dict[str, Scene]:
    """The clips, by name, that a scene or a single take stands for in a preset."""
    scene = named(name)
    takes = scene.takes if chosen.takes == "all" else ()
    return {name: scene, **{f"{name}-{take.name}": scene.take(take.name) for take in takes}}


def _render_frame(job: Job, tracer: Tracer, index: int, traced: Callable[[int], None]) -> None:
    view = views(tracer, job.buffers)
    pool = tracer.stack(job.preset.pool_spp)
    traced(job.preset.pool_spp)
    a, b, spp = rounds.trace(tracer, job.preset, job.scene.exposure, traced)
    if job.preset.rounds > 1:
        rounds.note(job.folder, index, spp)
    write_frame(job.folder, index, view, {"path": pool}, a, b)


def _render_all(jobs: list[Job], bar: Progress) -> None:
    area = jobs[0].preset.size[0] * jobs[0].preset.size[1]
    todo = {job: len(job.missing) * job.preset.frame_samples for job in jobs}
    total = sum(todo.values())
    trial = open_tracer(jobs[0].scene, *jobs[0].preset.size).sample_ms(repeats=1, spp=TRIAL)
    seconds = total / area * trial / 1e3
    most = "at most " if jobs[0].preset.rounds > 1 else ""
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    bar.console.print(
        f"rendering {len(jobs)} clips of preset {jobs[0].preset.name} with {llvm.activate()}: "
        f"{most}{total / 1e6:.0f} million light paths, about {_duration(seconds)}; "
        f"into {jobs[0].folder.parent}"
    )
    task = bar.add_task("", total=total)
    for job in jobs:
        bar.update(task, description=job.name)
        render(job, partial(bar.advance, task))
        gc.collect()


def _header(job: Job, tracer: Tracer) -> Header:
    plan, scene = job.preset, job.scene
    return Header(
        name=job.name,
        scene=scene.name,
        preset=plan.name,
        sampler="mitsuba path",
        sampler_version=f"{importlib.metadata.version('mitsuba')} {llvm.activate()}",
        height=plan.size[0],
        width=plan.size[1],
        frames=plan.frames,
        seed=SEED,
        exposure=scene.exposure,
        pool_spp=plan.pool_spp,
        radiance_cap=plan.cap,
        reference_spp=tuple(map(job.spent, range(plan.frames))),
        noise_ceiling_db=tuple(
            rounds.stored_ceiling_db(job.folder, index, *plan.size, scene.exposure)
            for index in range(plan.frames)
        ),
        buffers=job.buffers,
        pools=POOLS,
        static=scene.static,
        cuts=tuple(cut for cut in scene.cuts if cut < plan.frames),
        licence=scene.licence,
        sample_ms=tracer.sample_ms(),
        device=machine().cpu,
    )


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


@contextmanager
def _shown(progress: Progress | None) -> Iterator[Progress]:
    """The caller's bar, or one of its own on standard error."""
    if progress:
        yield progress
        return
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TaskProgressColumn())
    with Progress(
        *columns, TimeRemainingColumn(), console=Console(stderr=True), speed_estimate_period=120
    ) as bar:
        yield bar

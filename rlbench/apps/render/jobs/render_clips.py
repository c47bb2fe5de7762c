"""Renders the missing frames of clips, frame by frame; can be interrupted and resumed at any time.

An executor traces the frames, here or on other machines; this process writes them. Headers are
written last, because they hold the time of a sample, which must be measured on an idle tracer.
"""

from __future__ import annotations

import importlib.metadata
import inspect
import logging
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench import registry
from rlbench.apps.render.jobs import extra_pools
from rlbench.apps.render.jobs.job import (
    SEED,
    FrameRenderer,
    FrameTask,
    Job,
    frame_resources,
    measure_trace_times,
    read_whole_length,
    save_frame,
)
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Scene, SceneError
from rlbench.apps.render.windows import show_window
from rlbench.clips import presets
from rlbench.clips.header import ClipError, Header, read_header, write_header
from rlbench.clips.presets import Preset
from rlbench.errors import OptionError
from rlbench.parallel.executor import LOCAL, Executor, ProgressCallback
from rlbench.registry.near_names import unknown_name
from rlbench.system import paths
from rlbench.system.progress import LoggedProgress, format_duration
from rlbench.system.provenance import machine

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor

_logger = logging.getLogger(__name__)

TRIAL_SPP = 8  # samples per pixel that are traced to estimate the rendering time
SPEED_WINDOW_S = 120  # progress of this period gives the remaining time
PARALLEL_SPEED_WINDOW_S = 3600  # the same if progress arrives in whole frames


def ensure(
    preset: Preset | str,
    scenes: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    executor: Executor = LOCAL,
    limit_frames: int | None = None,
) -> list[Path]:
    """The clip folders of `preset_jobs`, after rendering the missing frames."""
    jobs = preset_jobs(preset, scenes, seeds)
    return render_missing([replace(job, limit_frames=limit_frames) for job in jobs], executor)


def preset_jobs(
    preset: Preset | str,
    scenes: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    folder: Path | None = None,
) -> list[Job]:
    """The render jobs of a preset's clips; nothing is rendered.

    `scenes`, and `seeds` of generated scenes, replace those of the preset; if only one of the two
    is given, the other is empty. A scene name selects the takes that the preset has of it,
    `<scene>-<take>` selects one take. `folder` holds the clips in place of the cache. Raises
    LookupError for an unknown preset or scene, and SceneError for an unknown take.
    """
    preset = presets.get_preset(preset) if isinstance(preset, str) else preset
    folder = folder or paths.clips_folder() / preset.name
    scene_of: dict[str, Scene] = {}
    for name in preset.clip_names(scenes, seeds):
        takes = _select_takes(name, preset)
        scene_of |= {clip: show_clip(scene, clip, preset) for clip, scene in takes.items()}
    _check_complete(scene_of, preset)
    return [Job(name, scene, preset, folder / name) for name, scene in scene_of.items()]


def preset_hash(preset: str) -> str:
    """16 hex digits of the names and contents of a preset's clips: a key to cache them by.

    Nothing is rendered. Raises UnknownPresetError.
    """
    jobs = preset_jobs(preset)
    content = [f"{job.name} {' '.join(job.preset.pools)} {job.content_key}" for job in jobs]
    return sha256("".join(content).encode()).hexdigest()[:16]


def _check_complete(scenes: Mapping[str, Scene], preset: Preset) -> None:
    """Raise SceneError if a clip that is reported would lack parts of its scene."""
    for name, scene in scenes.items() if preset.uses == ("report",) else ():
        if scene.missing_files:
            raise SceneError(
                f"clip {name} of preset {preset.name} is reported, and its scene misses "
                f"{len(scene.missing_files)} files, such as {scene.missing_files[0]}: run "
                f"`rlbench scenes get {scene.name}`"
            )


def render_missing(jobs: list[Job], executor: Executor = LOCAL) -> list[Path]:
    """The folders of clips of one preset, after rendering the missing frames.

    Complete frames are kept unless the scene has changed since.

    Pools other than the path tracer's are added last, always on this machine: their samples depend
    on earlier frames.
    """
    unfinished = [job for job in jobs if not job.is_finished]
    for job in jobs:
        status = f"{len(job.missing_frames)} frames missing" if job in unfinished else "finished"
        _logger.info("clip %s: %s, in %s", job.name, status, job.folder)
    if unfinished:
        with progress_bar(executor) as bar:
            _render_all(unfinished, bar, executor)
    if missing := extra_pools.find_missing_pools(jobs):
        with progress_bar(LOCAL) as bar:
            extra_pools.add_pools(missing, bar)
    return [job.folder for job in jobs]


def scene_of_clip(clip: str) -> Scene:
    """The scene of a clip, by the name of the clip.

    The name is that of an installed scene, `<scene>-<take>`, or `<scene>-<seed>` for a scene that
    takes a `seed`, such as `generated`. Raises LookupError for an unknown scene, and SceneError for
    an unknown take or a missing seed.
    """
    name, _, suffix = clip.rpartition("-")
    installed = registry.list_plugins("scenes")
    is_main = clip in installed or name not in installed
    plugin = registry.load_plugin("scenes", clip if is_main else name)
    seed = inspect.signature(plugin).parameters.get("seed")
    scene: Scene
    if seed is not None and not is_main and suffix.isdecimal():
        scene = plugin(int(suffix))
    elif seed is not None and seed.default is inspect.Parameter.empty:
        raise SceneError(
            f"'{clip}' is not a generated scene; give a seed, for example "
            f"{clip if is_main else name}-007"
        )
    else:
        scene = plugin() if is_main else plugin().select_take(suffix)
    return scene


def scene_of_header(header: Header) -> Scene:
    """The scene of a rendered clip, as its preset shows it. Raises as `scene_of_clip`."""
    scene, preset = scene_of_clip(header.name), presets.preset_of_clip(header.preset)
    return show_clip(scene, header.name, preset) if preset else scene


def show_clip(scene: Scene, clip: str, preset: Preset) -> Scene:
    """The scene of a clip as a preset shows it: at its speed, or through a window."""
    if preset.windows:
        return show_window(scene, clip, preset.frames)
    return scene.at_speed(preset.speed(clip))


def render_clip(
    job: Job, on_progress: ProgressCallback = lambda samples: None, executor: Executor = LOCAL
) -> None:
    """Render the missing frames of one clip, then write its header.

    Stored radiance is not exposed; the header holds the exposure. `on_progress` receives the light
    paths of each launch. If interrupted and called again, it writes the same files. A frame that
    fails does not stop the others; its error is raised at the end.
    """
    _raise_first(_render_frames([job], on_progress, executor))
    for missing_pool in extra_pools.find_missing_pools([job]):
        extra_pools.add_pool(missing_pool)


def _select_takes(name: str, preset: Preset) -> dict[str, Scene]:
    """The clips of a scene or of a single take, by clip name."""
    scene = scene_of_clip(name)
    takes = scene.takes if preset.takes == "all" else ()
    return {name: scene, **{f"{name}-{take.name}": scene.select_take(take.name) for take in takes}}


def _render_frames(
    jobs: list[Job], on_progress: ProgressCallback, executor: Executor
) -> list[Exception]:
    """Render the missing frames, then write headers; returns the errors of frames that failed."""
    jobs = [job.inspect() for job in jobs]
    for job in jobs:
        job.claim_folder()
    renderer = FrameRenderer(jobs)
    tasks = [
        FrameTask(clip, index) for clip, job in enumerate(jobs) for index in job.missing_frames
    ]
    errors = []
    for result in executor.map(renderer, tasks, frame_resources(), on_progress):
        if result.error:
            errors.append(result.error)
        else:
            save_frame(jobs[result.job.clip_index], result.job.frame, result.result())
    for clip, job in enumerate(jobs):
        if not (job.missing_frames or job.is_finished):  # a header of more frames stays
            write_header(job.folder, _make_header(job, renderer.open_clip_scene(clip)))
    return errors


def _render_all(jobs: list[Job], bar: Progress, executor: Executor) -> None:
    jobs = [jobs[0].inspect(), *jobs[1:]]  # the first is traced for the estimate already
    bar.console.print(_estimate(jobs, executor))
    task = bar.add_task("", total=_count_paths(jobs))
    errors: list[Exception] = []
    for batch in [[job] for job in jobs] if executor.exclusive else [jobs]:
        bar.update(task, description=batch[0].name if len(batch) == 1 else f"{len(batch)} clips")
        errors += _render_frames(batch, partial(bar.advance, task), executor)
    _raise_first(errors)


def _estimate(jobs: list[Job], executor: Executor) -> str:
    """The work ahead in words, with the time it takes on this machine, after a short trial."""
    preset, paths_to_trace = jobs[0].preset, _count_paths(jobs)
    trial_ms = open_tracer(jobs[0].scene, *preset.size).measure_sample_ms(repeats=1, spp=TRIAL_SPP)
    seconds = paths_to_trace / (preset.size[0] * preset.size[1]) * trial_ms / 1e3
    at_most = "at most " if preset.max_reference_rounds > 1 else ""
    alone = f" on this machine alone; {executor.description}" if executor.description else ""
    frames, clips = (
        f"{count} {name}{'s' * (count > 1)}"
        for count, name in ((jobs[0].frames, "frame"), (len(jobs), "clip"))
    )
    part = f"{frames} of " * (jobs[0].frames < preset.frames)
    return (
        f"rendering {part}{clips} of preset {preset.name} with {select_variant()} "
        f"to {jobs[0].folder.parent}: {at_most}{paths_to_trace / 1e6:.0f} million light paths, "
        f"about {format_duration(seconds)}{alone}. "
        "If interrupted, the same command resumes it"
    )


def _count_paths(jobs: list[Job]) -> int:
    return sum(len(job.missing_frames) * job.preset.paths_per_frame for job in jobs)


def _raise_first(errors: list[Exception]) -> None:
    if len(errors) > 1:
        errors[0].add_note(f"{len(errors) - 1} more frames failed; the last error: {errors[-1]}")
    if errors:
        raise errors[0]


def _make_header(job: Job, tracer: Tracer) -> Header:
    version = f"{importlib.metadata.version('mitsuba')} {select_variant()}"
    times = measure_trace_times(tracer)
    return times.written_to(job.make_header("mitsuba path", version, times.sample_ms, seed=SEED))


def progress_bar(executor: Executor) -> LoggedProgress:
    """A progress bar on standard error."""
    columns = (
        TextColumn("{task.description:>16}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
    )
    window = SPEED_WINDOW_S if executor.exclusive else PARALLEL_SPEED_WINDOW_S
    return LoggedProgress(*columns, TimeRemainingColumn(), speed_estimate_period=window)


def render_preset_clips(
    scenes: list[str] | None,
    preset: str,
    radiance_cap: float | None = None,
    seeds: tuple[int, ...] | None = None,
    buffers: list[str] | None = None,
    executor: Executor | None = None,
    pool_kinds: Collection[str] | None = None,
    takes: str | None = None,
    size: tuple[int, int] | None = None,
    limit_frames: int | None = None,
) -> list[Path]:
    """The clip folders of a preset, after rendering the missing frames.

    `size` in pixels (height, width), `radiance_cap` and extra G-buffer `buffers` select a variant
    of the preset, in folders of its own. `scenes`, seeds of generated scenes, and `takes` (main or
    all) replace those of the preset. Of its sample pools only the given kinds are rendered; default
    all. With `limit_frames` the frames after the first ones are not rendered; those that are there
    stay. Raises UnknownPresetError and OptionError for an unknown preset or scene, and PresetError
    for other values.
    """
    selected = presets.get_preset(preset, size)
    installed = registry.list_plugins("scenes")
    for name in scenes or ():
        if not {name, name.rpartition("-")[0]} & set(installed):
            raise OptionError(unknown_name(f"no scene '{name}'", name, installed))
    if radiance_cap is not None:
        selected = selected.with_radiance_cap(radiance_cap)
    if buffers:
        selected = selected.with_buffers(buffers)
    if pool_kinds is not None:
        selected = selected.with_pools(pool_kinds)
    if takes is not None:
        selected = selected.with_takes(takes)
    return ensure(selected, scenes or None, seeds, executor or LOCAL, limit_frames)


def remeasure_sample_ms(folder: Path) -> Header:
    """Measure the times of a clip of an installed scene, write its header and return it.

    These are `sample_ms`, its percentiles and `gbuffer_ms`. The times of other pools keep their
    ratio to the path tracer's, because that ratio was measured in alternating pairs, which other
    load on the machine slows alike. Pixels do not change. Raises ClipError if another machine
    rendered the clip.
    """
    header, this_machine = read_header(folder), machine().name
    if header.device != this_machine:
        raise ClipError(
            f"clip {folder} was rendered on '{header.device}', so its time per sample cannot be "
            f"measured on '{this_machine}'. Run this on '{header.device}'; `rlbench run --cost "
            "measured` times samples on this machine"
        )
    size = header.height, header.width
    frames = read_whole_length(folder) or header.frames
    tracer = open_tracer(scene_of_header(header).inspect(frames, size), *size)
    times = measure_trace_times(tracer)
    ratio = times.sample_ms / header.sample_ms if header.sample_ms > 0 else math.nan
    others = (ms * ratio for ms in header.pools_ms[1:])  # the path tracer's pool comes first
    pools_ms = (times.sample_ms, *others) if header.pools_ms else ()
    remeasured = replace(times.written_to(header), pools_ms=pools_ms)
    write_header(folder, remeasured)
    return remeasured

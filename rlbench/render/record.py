"""Rendering what is missing of a preset's clips, frame by frame, resumable at any moment."""

from __future__ import annotations

import gc
import hashlib
import importlib.metadata
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from rlbench import paths
from rlbench.clips import Header, has_frame, read_header, write_frame, write_header
from rlbench.folder import exr_path, kinds
from rlbench.frames import BUFFERS
from rlbench.header import FILE
from rlbench.render import llvm
from rlbench.render.pose import Pose
from rlbench.render.presets import GENERATED, Preset, preset
from rlbench.render.scene import Scene
from rlbench.render.trace import Tracer, open_tracer, sample_ms

RECIPE = 1  # raised whenever the tracer gives other pixels for the same scene
POOLS = ("path",)
MARK = "scene.txt"  # beside the frames: what they were rendered from
SEED = 0  # of the light paths; frames, samples and streams have their own numbers below it
TRIAL = 4  # samples per pixel traced to estimate how long the rest takes


class RenderError(LookupError):
    """A scene that cannot be rendered as asked."""


@dataclass(frozen=True)
class Job:
    """One clip to be rendered."""

    name: str
    build: Callable[[], Scene]
    preset: Preset
    folder: Path

    @property
    def missing(self) -> list[int]:
        """Frames that are not wholly there yet."""
        return [i for i in range(self.preset.frames) if not has_frame(self.folder, i, POOLS)]

    @property
    def finished(self) -> bool:
        """Is there a header, and every frame?"""
        return (self.folder / FILE).is_file() and not self.missing


def ensure(
    chosen: Preset | str,
    scenes: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """The clip folders of a preset, after rendering what is missing of them.

    `scenes` and `seeds` choose among the preset's, or name others; given one of them, the other is
    empty. Frames that are there are kept, unless their scene has changed since. `folder` holds the
    clips, in place of the cache. Raises LookupError for an unknown preset or scene.
    """
    chosen = preset(chosen) if isinstance(chosen, str) else chosen
    folder = folder or paths.clips() / chosen.name
    if scenes is None and seeds is None:
        scenes, seeds = chosen.scenes, chosen.seeds
    builds = {name: _registered(name) for name in scenes or ()}
    builds |= {f"{GENERATED}-{seed:03d}": partial(_generated, seed) for seed in seeds or ()}
    jobs = [Job(name, build, chosen, folder / name) for name, build in builds.items()]
    stale = [job for job in jobs if not _current(job)]
    if stale:
        with _bar(progress) as bar:
            _render_all(stale, bar)
    return [job.folder for job in jobs]


def render_clip(job: Job, progress: Callable[[int], None] = lambda samples: None) -> None:
    """Render the missing frames of one clip, then its header. Stored radiance is not exposed.

    `progress` is told of samples as they are traced.
    """
    scene = job.build()
    _mark(job, fingerprint(scene, job.preset))
    height, width = job.preset.size
    tracer = open_tracer(scene, height, width, SEED)
    for index in job.missing:
        tracer.set_time(float(index))
        _render_frame(job, tracer, index, progress)
    write_header(job.folder, _header(job, scene, sample_ms(tracer)))


def fingerprint(scene: Scene, chosen: Preset) -> str:
    """What the pixels depend on, as a short hash that two machines agree on.

    Shapes and poses enter rounded, as sums, so that the last bit of a sine does not matter.
    """
    last = chosen.frames - 1
    words = [f"{RECIPE} {chosen.size} {chosen.pool_spp} {chosen.reference_spp} {scene.depth}"]
    words += [_summary(sky) for sky in scene.sky]
    words += [f"{m.name} {m.smooth} {_summary([m.faces, m.material, m.uv, m.emission])}" for m in scene.meshes]
    for pose in (Pose.of(scene, t) for t in (0.0, float(last))):
        words.append(_summary([pose.camera.origin, pose.camera.target, pose.camera.fov]))
        words += [_summary(vertices) for vertices in pose.vertices]
    return hashlib.blake2b("\n".join(words).encode(), digest_size=8).hexdigest()

"""Renders a user's scene file as a clip: opens it, chooses camera path and exposure, renders."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.jobs.job import FRAME_POOLS, Job
from rlbench.apps.render.jobs.render_clips import render_missing
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Camera, Scene, SceneError
from rlbench.apps.render.user import auto_exposure, camera_path
from rlbench.apps.render.user.scene_file import UserScene, open_scene_file
from rlbench.apps.render.user.sky import add_sky, describe_sky
from rlbench.apps.render.user.wander import WANDER_VERSION, find_view, wander
from rlbench.clips.presets import Preset
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.system import paths

FOLDER = "own-"  # prefix of the preset's folder in the cache
MOVING = ("orbit", "dolly", "wander")  # paths that depend on the surfaces in view
SIZE_MULTIPLE = 16  # pixels: chosen widths and heights are multiples of it


@dataclass(frozen=True)
class UserSceneOptions:
    """The options of `rlbench render`."""

    file: Path
    camera: str = ""  # a kind of path or a JSON file; default the scene's animation or an orbit
    frames: int | None = None  # default: one per matrix, or those of the preset
    size: tuple[int, int] | None = None  # height, width; default: the film's shape at preset size
    exposure: float | None = None  # default: that of the Scene, or an estimate
    parameters: tuple[tuple[str, str], ...] = ()  # values for an XML file's <default> names
    out: Path | None = None  # the clip folder; default one in the cache
    seed: int | None = None  # of a random path, for `wander` alone
    sky: str = ""  # added to the scene: a radiance, white, sun, or the file of a map
    skip_missing: bool = False  # leave out shapes and textures whose files do not exist?
    limit_frames: int | None = None  # of the clip's frames that are rendered, the first ones


@dataclass(frozen=True)
class CameraPath:
    """The camera's motion: the scene's own, matrices, or a path from the first of them."""

    kind: str  # own, still, orbit, dolly, wander, or the name of a JSON file
    matrices: tuple[Float[Array, "4 4"], ...] = ()
    fov: float = 60.0  # horizontal, degrees
    seed: int = 0  # of wander
    has_start: bool = True  # or does wander look for a first view, as the file has no camera?

    @property
    def is_static(self) -> bool:
        """True if all matrices are equal."""
        first = self.matrices[:1]
        return self.kind not in ("own", *MOVING) and all(
            (m == first[0]).all() for m in self.matrices
        )

    @property
    def name(self) -> str:
        """The kind, with the seed of a random path."""
        return f"{self.kind}-{self.seed:03d}" if self.kind == "wander" else self.kind

    def camera_at_time(
        self, path: camera_path.MatrixPath | None = None
    ) -> Callable[[float], Camera]:
        """The pinhole as a function of time, along `path` or else along the matrices."""
        matrix_at = path or camera_path.follow_matrices(self.matrices)
        return lambda time: camera_path.camera_from_matrix(matrix_at(time), self.fov)

    def move_around(self, distance: float, frames: int) -> Callable[[float], Camera]:
        """The pinhole on an orbit around the point `distance` ahead, or on a dolly towards it."""
        start = self.matrices[0]
        if self.kind == "orbit":
            return self.camera_at_time(camera_path.orbit(start, distance, frames))
        return self.camera_at_time(camera_path.dolly(start, distance))

    def choose_camera(self, tracer: Tracer, frames: int) -> Callable[[float], Camera]:
        """The pinhole on a path that depends on the surfaces in view."""
        if self.kind != "wander":
            return self.move_around(auto_exposure.measure_distance(tracer), frames)
        start = self.matrices[0] if self.has_start else find_view(tracer, self.fov)
        matrices = wander(tracer, start, self.fov, frames, self.seed)
        return self.camera_at_time(camera_path.follow_matrices(matrices))


def ensure_user_clip(
    options: UserSceneOptions,
    preset: Preset,
    on_message: Callable[[str], None] = lambda message: None,
    executor: Executor = LOCAL,
) -> Path:
    """The clip folder of a user's scene, after rendering the missing frames.

    Nothing is written before all frames have been inspected. `on_message` receives the chosen
    settings, and the differences between the file and the rendering. Raises SceneError if the scene
    cannot be rendered with these options, and ClipError if `out` holds frames of another renderer.
    """
    select_variant()
    user_scene = open_scene_file(options.file, options.parameters, options.skip_missing)
    job, _ = plan_clip(options, user_scene, preset)
    if job.is_finished:
        return job.folder
    for note in user_scene.notes:
        on_message(note)
    job = job.inspect()
    on_message(describe_job(job))
    return render_missing([job], executor)[0]


def plan_clip(
    options: UserSceneOptions, user_scene: UserScene, preset: Preset
) -> tuple[Job, CameraPath]:
    """The render job of an opened scene, and its camera path; `Job.inspect` chooses the rest.

    Raises SceneError for options that do not fit the scene.
    """
    path = _choose_path(options, user_scene)
    size = _choose_size(options, user_scene, preset)
    frames = _choose_frames(options, path, preset)
    own_preset = replace(preset, frames=frames, size=size, pools=FRAME_POOLS)
    name = re.sub(r"[^\w.-]+", "-", f"{user_scene.name}-{path.name}")
    folder = options.out or paths.clips_folder() / f"{FOLDER}{preset.name}" / name
    if folder.exists() and not folder.is_dir():
        raise SceneError(f"--out {folder} is a file; give a folder, which need not exist")
    scene = _make_scene(options, user_scene, path, frames)
    return Job(name, scene, own_preset, folder, options.limit_frames), path


def describe_job(job: Job) -> str:
    """The clip's name, number of frames, size and exposure in one line."""
    preset = job.preset
    size = f"{preset.size[1]}x{preset.size[0]}"
    part = f"the first {job.frames} of " * (job.frames < preset.frames)
    return f"{job.name}: {part}{preset.frames} frames of {size}, exposure {job.scene.exposure:g}"


def _inspect(
    scene: Scene, path: CameraPath, exposure: float | None, frames: int, size: tuple[int, int]
) -> Scene:
    """The scene with its camera and, unless one is given, an exposure, by a look at every frame."""
    select_variant()
    with auto_exposure.mitsuba_errors():
        tracer = open_tracer(scene, *size)
    if path.kind in MOVING:
        scene = replace(scene, camera=path.choose_camera(tracer, frames))
        tracer.scene = scene
    estimate = auto_exposure.estimate_exposure(tracer, frames)
    return replace(scene, exposure=exposure or estimate)


def _choose_path(options: UserSceneOptions, user_scene: UserScene) -> CameraPath:
    kind = options.camera or ("own" if user_scene.animates_camera else "orbit")
    if options.seed is not None and kind != "wander":
        raise SceneError(f"--seeds draws random paths, and --camera is {kind}. Use --camera wander")
    if kind == "own" and user_scene.animates_camera:
        return CameraPath(kind)
    kind = "still" if kind == "own" else kind
    if kind in ("still", *MOVING):
        has_start = kind != "wander" or user_scene.camera_to_world is not None
        matrices = (user_scene.sensor_matrix() if has_start else np.eye(4),)
        return CameraPath(kind, matrices, user_scene.fov, options.seed or 0, has_start)
    read, fov = camera_path.read_matrices(Path(kind))
    return CameraPath(Path(kind).stem, tuple(read), fov or user_scene.fov)


def _choose_frames(options: UserSceneOptions, path: CameraPath, preset: Preset) -> int:
    available = len(path.matrices)
    if path.kind in ("own", "still", *MOVING):
        return options.frames or preset.frames
    if options.frames and options.frames > available:
        raise SceneError(
            f"--frames {options.frames}: {options.camera} has {available} matrices, one per frame. "
            f"Give --frames {available} at most"
        )
    return options.frames or available


def _choose_size(
    options: UserSceneOptions, user_scene: UserScene, preset: Preset
) -> tuple[int, int]:
    """Height and width: as given, or the film's shape with about as many pixels as the preset."""
    if options.size or not user_scene.aspect:
        return options.size or preset.size
    aspect = user_scene.aspect
    height = math.sqrt(preset.size[0] * preset.size[1] / aspect)
    high, wide = (
        max(1, round(side / SIZE_MULTIPLE)) * SIZE_MULTIPLE for side in (height, height * aspect)
    )
    return high, wide


def _make_scene(
    options: UserSceneOptions, user_scene: UserScene, path: CameraPath, frames: int
) -> Scene:
    """The scene before inspection, with the hash of its source files and its camera path."""
    matrices = [matrix.tolist() for matrix in path.matrices]
    chosen = f"{WANDER_VERSION} {path.name}" if path.kind == "wander" else path.kind
    source = (
        f"{user_scene.content_hash(frames)} {chosen} {matrices} {path.fov} "
        f"exposure {options.exposure}"
    )
    if options.sky:
        source += f" sky {describe_sky(options.sky)}"
    is_own = path.kind == "own"
    scene = add_sky(user_scene.scene, options.sky) if options.sky else user_scene.scene
    scene = replace(
        scene,
        name=user_scene.name,
        camera=scene.camera if is_own else path.camera_at_time(),
        cuts=scene.cuts if is_own else (),
        takes=(),
        static=scene.static if is_own else path.is_static and not user_scene.has_moving_shapes,
        source_hash=hashlib.blake2b(source.encode(), digest_size=16).hexdigest(),
        licence="",  # the scene's author decides
        missing_files=user_scene.missing_files,
    )
    exposure = options.exposure or (scene.exposure if user_scene.animates_camera else None)
    return replace(scene, inspector=partial(_inspect, scene, path, exposure))

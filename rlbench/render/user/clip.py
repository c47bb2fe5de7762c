"""A user's own scene as a clip: opened, given a camera path, looked at, exposed, rendered."""

from __future__ import annotations

import gc
import hashlib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.parallel.executor import LOCAL, Executor
from rlbench.render.jobs.job import FRAME_POOLS, Job
from rlbench.render.jobs.render_clips import render_missing
from rlbench.render.mitsuba import llvm
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import Preset
from rlbench.render.scene import Camera, Scene, SceneError
from rlbench.render.user import auto_exposure, camera_path
from rlbench.render.user.scene_file import UserScene, open_scene_file
from rlbench.system import paths

FOLDER = "own-"  # of these clips in the cache, with the preset's name
STEP = 16  # pixels: widths and heights that are chosen here are multiples of it


@dataclass(frozen=True)
class UserSceneOptions:
    """What is asked of a user's scene file."""

    file: Path
    camera: str = ""  # still, orbit, dolly, or a JSON file; else the Scene's own, or an orbit
    frames: int | None = None  # else as many as there are matrices, or as the preset has
    size: tuple[int, int] | None = None  # height, width; else the film's shape, as many pixels
    exposure: float | None = None  # else a Scene's own, or of an XML that of sight.survey
    parameters: tuple[tuple[str, str], ...] = ()  # of an XML file's <default> names
    out: Path | None = None  # the clip's folder; else one in the cache


@dataclass(frozen=True)
class CameraPath:
    """How the camera goes: by itself ("own"), through matrices, or from the first of them."""

    kind: str  # own, still, orbit, dolly, or the name of a JSON file
    matrices: tuple[Float[Array, "4 4"], ...] = ()
    fov: float = 60.0

    @property
    def is_static(self) -> bool:
        """Is it the same matrix throughout?"""
        first = self.matrices[:1]
        return self.kind not in ("own", "orbit", "dolly") and all(
            (m == first[0]).all() for m in self.matrices
        )

    def camera_at_time(
        self, path: camera_path.MatrixPath | None = None
    ) -> Callable[[float], Camera]:
        """The pinhole on `path`, or else through the matrices."""
        route = path or camera_path.follow_matrices(self.matrices)
        return lambda time: camera_path.camera_from_matrix(route(time), self.fov)

    def move_around(self, away: float, frames: int) -> Callable[[float], Camera]:
        """The pinhole on an orbit of the point `away` ahead, or on a dolly towards it."""
        start = self.matrices[0]
        orbits = self.kind == "orbit"
        return self.camera_at_time(
            camera_path.orbit(start, away, frames) if orbits else camera_path.dolly(start, away)
        )


def ensure_own(
    wish: UserSceneOptions,
    preset: Preset,
    tell: Callable[[str], None] = lambda words: None,
    engine: Executor = LOCAL,
) -> Path:
    """The clip folder of a user's scene, after rendering what is missing of it.

    Nothing is written before the whole camera path was looked at. `tell` hears what was decided,
    and what is rendered otherwise than the file says. Raises SceneError where the scene cannot be
    rendered as asked, and ClipError where `out` holds frames of another origin.
    """
    llvm.select_variant()
    found = open_scene_file(wish.file, wish.parameters)
    job, route = plan_clip(wish, found, preset)
    if job.is_finished:
        return job.folder
    for note in found.notes:
        tell(note)
    seen, usual = _looked(job.scene, route, job.preset)
    own = seen.exposure if found.animates_camera else usual
    job = replace(job, scene=replace(seen, exposure=wish.exposure or own))
    tell(describe_job(job))
    return render_missing([job], engine=engine)[0]


def plan_clip(wish: UserSceneOptions, found: UserScene, preset: Preset) -> tuple[Job, CameraPath]:
    """What is to be rendered of an opened scene, before it was looked at. Raises SceneError."""
    route = _route(wish, found)
    size = _size(wish, found, preset)
    plan = replace(preset, frames=_frames(wish, route, preset), size=size, pools=FRAME_POOLS)
    name = re.sub(r"[^\w.-]+", "-", f"{found.name}-{route.kind}")
    folder = wish.out or paths.clips() / f"{FOLDER}{preset.name}" / name
    if folder.exists() and not folder.is_dir():
        raise SceneError(f"--out {folder} is a file; it takes a folder, which need not exist")
    return Job(name, _scene(wish, found, route, plan), plan, folder), route


def describe_job(job: Job) -> str:
    """What was decided, in words."""
    plan = job.preset
    size = f"{plan.size[1]}x{plan.size[0]}"
    return f"{job.name}: {plan.frames} frames of {size}, exposure {job.scene.exposure:g}"


def _looked(scene: Scene, route: CameraPath, plan: Preset) -> tuple[Scene, float]:
    """`scene` on its route, and the exposure that would suit it, after a look at every frame."""
    with auto_exposure.mitsuba_errors():
        tracer = open_tracer(scene, *plan.size)
    if route.kind in ("orbit", "dolly"):
        camera = route.move_around(auto_exposure.measure_distance(tracer), plan.frames)
        tracer.scene = replace(scene, camera=camera)
    exposure, seen = auto_exposure.estimate_exposure(tracer, plan.frames), tracer.scene
    del tracer
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    return seen, exposure


def _route(wish: UserSceneOptions, found: UserScene) -> CameraPath:
    kind = wish.camera or ("own" if found.animates_camera else "orbit")
    fov = found.fov
    if kind == "own":
        return CameraPath(kind)
    if kind in ("still", "orbit", "dolly"):
        return CameraPath(kind, (found.sensor_matrix(),), fov)
    matrices, given = camera_path.read_matrices(Path(kind))
    return CameraPath(Path(kind).stem, tuple(matrices), given or fov)


def _frames(wish: UserSceneOptions, route: CameraPath, preset: Preset) -> int:
    there = len(route.matrices)
    if route.kind in ("own", "still", "orbit", "dolly"):
        return wish.frames or preset.frames
    if wish.frames and wish.frames > there:
        raise SceneError(
            f"--frames {wish.frames}: {wish.camera} has {there} matrices, one a frame; "
            f"ask for {there} at most"
        )
    return wish.frames or there


def _size(wish: UserSceneOptions, found: UserScene, preset: Preset) -> tuple[int, int]:
    """Height and width: as asked, or about as many pixels as the preset's in the film's shape."""
    if wish.size or not found.aspect:
        return wish.size or preset.size
    height = math.sqrt(preset.size[0] * preset.size[1] / found.aspect)
    high, wide = (max(1, round(side / STEP)) * STEP for side in (height, height * found.aspect))
    return high, wide


def _scene(wish: UserSceneOptions, found: UserScene, route: CameraPath, plan: Preset) -> Scene:
    """The scene as far as it is known before it is looked at, with the hash of its origin."""
    matrices = [matrix.tolist() for matrix in route.matrices]
    path = f"{route.kind} {matrices} {route.fov}"
    words = f"{found.content_hash(plan.frames)} {path} exposure {wish.exposure}"
    own = route.kind == "own"
    return replace(
        found.scene,
        name=found.name,
        camera=found.scene.camera if own else route.camera_at_time(),
        cuts=found.scene.cuts if own else (),
        takes=(),
        static=found.scene.static if own else route.is_static and not found.has_moving_shapes,
        origin=hashlib.blake2b(words.encode(), digest_size=16).hexdigest(),
        licence="",  # of the scene's author
    )

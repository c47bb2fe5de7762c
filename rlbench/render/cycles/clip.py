"""A user's Blender, USD, glTF or FBX scene as a clip: opened, looked at, rendered by Cycles.

Three kinds of job, each in a process of its own: small pictures for exposure, the views of all
frames, then radiance. What is whole is kept, so a killed rendering goes on.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rich.console import Console
from rich.progress import Progress

from rlbench.clips.stored import write_frame, write_header
from rlbench.render.cycles import passes
from rlbench.render.cycles.process import run_worker
from rlbench.render.cycles.scene_file import BlenderScene, open_blender_file
from rlbench.render.cycles.worker_job import CyclesParameters, ImageTask, image_seed, render_job
from rlbench.render.jobs import references
from rlbench.render.jobs.job import Job
from rlbench.render.presets import Preset
from rlbench.render.scene import SceneError
from rlbench.render.user import auto_exposure
from rlbench.render.user.clip import UserSceneOptions, describe_job, plan_clip
from rlbench.system import paths

SPAN = 32  # samples of a reference's picture: so much is lost at most when it is killed
LOOK = (32, 32)  # pixels of the pictures that the exposure is chosen by: 8 x 8 areas of 4 x 4
LOOK_SPP = 16
LUMINANCE = (0.2126, 0.7152, 0.0722)
WORK = ".cycles"  # beside the frames, until all are there
Tell = Callable[[str], None]


@dataclass(frozen=True)
class CyclesJob:
    """One clip that Cycles renders."""

    job: Job
    file: Path
    blender_scene: BlenderScene
    parameters: CyclesParameters

    @property
    def work_folder(self) -> Path:
        """Where the worker's pictures are until their frame is whole."""
        return self.job.folder / WORK

    def render_images(
        self, pictures: list[ImageTask], log: Path, geometry: bool = False, look: bool = False
    ) -> Iterator[tuple[Path, float]]:
        """Files as they are made, and the seconds each took; those that are there are left out."""
        missing = [picture for picture in pictures if not picture.file.is_file()]
        if not missing:
            return
        plan, scene = self.job.preset, self.job.scene
        size = LOOK if look else plan.size
        what = render_job(
            self.file,
            scene,
            self.blender_scene.start,
            plan.frames,
            size,
            self.parameters,
            missing,
            geometry,
        )
        for event in run_worker(what, log):
            if event.get("event") == "made":
                yield Path(event["file"]), event["seconds"]


def ensure_cycles(wish: UserSceneOptions, preset: Preset, tell: Tell = lambda words: None) -> Path:
    """The clip folder of a scene file that Cycles renders, after rendering what is missing of it.

    As `rlbench.render.user.clip.ensure_own`, with the file's own camera if it has one. Raises
    SceneError where the scene cannot be rendered as asked, ClipError where `out` holds frames of
    another origin, and CyclesError where Blender is missing or broke down.
    """
    asked = CyclesParameters.parse(wish.parameters)
    if preset.radiance_cap < np.inf:
        raise SceneError(f"preset {preset.name} has a radiance cap; Cycles' samples are not capped")
    found = open_blender_file(wish, wish.frames or preset.frames, asked)
    job, route = plan_clip(wish, found.user_scene, preset)
    if job.is_finished:
        return job.folder
    for note in found.user_scene.notes:
        tell(note)
    if route.kind in ("orbit", "dolly"):
        if not found.distance:
            raise SceneError(
                f"the camera of {wish.file} sees no surface in the middle of the picture, so there "
                "is nothing to move around; use --camera still, or a JSON file of matrices"
            )
        scene = replace(job.scene, camera=route.move_around(found.distance, job.preset.frames))
        job = replace(job, scene=scene)
    shoot = CyclesJob(job, wish.file, found, asked)
    usual = _exposure(shoot)
    job = replace(job, scene=replace(job.scene, exposure=wish.exposure or usual))
    tell(describe_job(job))
    _render(replace(shoot, job=job))
    return job.folder


def _exposure(shoot: CyclesJob) -> float:
    """What shows the frames at a usual brightness. Raises SceneError for one that is all black."""
    log = paths.cache() / "cycles" / f"{shoot.job.name}.log"
    with TemporaryDirectory(prefix="rlbench-") as place:
        looks = [
            ImageTask(
                Path(place, f"{index}.exr"),
                index,
                image_seed(index, "pilot", 0),
                LOOK_SPP,
                1,
                LOOK_SPP,
            )
            for index in range(shoot.job.preset.frames)
        ]
        for _ in shoot.render_images(looks, log, look=True):
            pass
        areas = np.stack([_areas(passes.read_radiance(look.file, LOOK)) for look in looks])
    if black := [str(index) for index, frame in enumerate(areas) if not frame.any()]:
        raise SceneError(
            f"frames {', '.join(black[:8])} are black: there is no light, none gets to what the "
            "camera sees, or the camera is inside something. --define world=1 adds a white sky; "
            "glTF and FBX do not carry every kind of lamp"
        )
    return auto_exposure.exposure_from_areas(areas)


def _areas(image: Float[Array, "h w 3"]) -> Float[Array, " areas"]:
    luminance = image @ np.array(LUMINANCE)
    side = LOOK[0] // auto_exposure.AREAS
    return np.asarray(
        luminance.reshape(auto_exposure.AREAS, side, auto_exposure.AREAS, side).mean((1, 3)).ravel()
    )


def _render(shoot: CyclesJob) -> None:
    """Render the missing frames, then write the header."""
    job = shoot.job
    job.claim_folder()
    _claim(shoot)
    plan = job.preset
    columns = Progress.get_default_columns()
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=120) as bar:
        area = plan.size[0] * plan.size[1]
        paths_left = len(job.missing_frames) * plan.paths_per_frame
        bar.console.print(
            f"rendering with Cycles (Blender {shoot.blender_scene.blender}): "
            f"at most {paths_left / 1e6:.2f} million light paths; into {job.folder}"
        )
        task = bar.add_task(job.name, total=paths_left)
        for spp in _frames(shoot):
            bar.advance(task, spp * area)
    version = f"Blender {shoot.blender_scene.blender}, {job.scene.depth - 2} bounces, light tree"
    seconds = _seconds(shoot.work_folder)
    sample_ms = seconds * 1e3 if np.isfinite(seconds) else float("nan")
    write_header(job.folder, job.make_header("cycles", version, sample_ms, stratified=True))
    shutil.rmtree(shoot.work_folder)


def _claim(shoot: CyclesJob) -> None:
    """An empty work folder, or the one of this very clip."""
    mark = shoot.work_folder / "mark.txt"
    if not (mark.is_file() and mark.read_text() == shoot.job.content_key):
        shutil.rmtree(shoot.work_folder, ignore_errors=True)
        with paths.replacing(mark) as path:
            path.write_text(shoot.job.content_key)


def _frames(shoot: CyclesJob) -> Iterator[int]:
    """Render and write all missing frames, in rounds; yields samples per pixel as they are done."""
    job, work = shoot.job, shoot.work_folder
    views = [ImageTask(_geometry(work, i), i, image_seed(i, "path", 0)) for i in job.missing_frames]
    for _ in shoot.render_images(views, work / "geometry.log", geometry=True):
        pass
    for done in range(1, job.preset.max_reference_rounds + 1):
        pictures = {index: _pictures(shoot, index, done) for index in job.missing_frames}
        for index in pictures:
            _settle(shoot, index, done)
        wanted = [picture for index in job.missing_frames for picture in pictures[index]]
        spp = {picture.file: (picture.frame, picture.spp) for picture in wanted}
        yield sum(p.spp for p in wanted if p.file.is_file()) if done == 1 else 0
        for file, seconds in shoot.render_images(wanted, work / f"round{done}.log"):
            index, samples = spp[file]
            if file.name.startswith("reference"):
                _time(work, seconds / samples)
            _settle(shoot, index, done)
            yield samples


def _pictures(shoot: CyclesJob, index: int, done: int) -> list[ImageTask]:
    """All radiance pictures of a frame in rounds up to `done`: samples, then both halves."""
    plan, work = shoot.job.preset, shoot.work_folder.absolute()
    found = [
        ImageTask(work / f"path.{index:04d}.{slot}.exr", index, image_seed(index, "path", slot))
        for slot in range(plan.pool_spp)
    ]
    for half in references.HALVES:
        for turn in range(done):
            found += reference_images(work, f"reference{half}", index, turn, plan.reference_spp)
    return found


def reference_images(work: Path, stream: str, index: int, turn: int, total: int) -> list[ImageTask]:
    """What one round adds to one half of a reference: one seed, its samples in spans."""
    name, number = f"{stream}.{index:04d}.{turn}", image_seed(index, stream, turn)
    return [
        ImageTask(
            work / f"{name}.{first}.exr", index, number, min(SPAN, total - first + 1), first, total
        )
        for first in range(1, total + 1, SPAN)
    ]


def _settle(shoot: CyclesJob, index: int, done: int) -> None:
    """Write a frame if all its pictures are there, and its reference is good enough or the last."""
    job, plan = shoot.job, shoot.job.preset
    pictures = _pictures(shoot, index, done)
    if not all(picture.file.is_file() for picture in pictures):
        return
    halves = {}
    for half in references.HALVES:
        own = [p for p in pictures if p.file.name.startswith(f"reference{half}.")]
        weighted = [passes.read_radiance(p.file, plan.size) * np.float64(p.spp) for p in own]
        total = np.sum(weighted, axis=0) / sum(p.spp for p in own)
        halves[half] = total.astype(np.float32)
    a, b = halves["A"], halves["B"]
    if (
        done < plan.max_reference_rounds
        and references.noise_ceiling_db(a, b, job.scene.exposure) < plan.min_noise_ceiling_db
    ):
        return
    file = _geometry(shoot.work_folder, index)
    gbuffer = passes.read_gbuffer(file, job.scene, index, plan.size)
    samples = [p for p in pictures if p.file.name.startswith("path.")]
    pool = np.stack([passes.read_radiance(p.file, plan.size) for p in samples])
    if plan.max_reference_rounds > 1:
        references.write_spp(job.folder, index, 2 * plan.reference_spp * done)
    gbuffer = {name: gbuffer[name] for name in job.buffers}
    write_frame(job.folder, index, gbuffer, {"path": pool}, a, b)
    for picture in pictures:
        picture.file.unlink()
    file.unlink()


def _geometry(work: Path, index: int) -> Path:
    return work.absolute() / f"view.{index:04d}.exr"


def _time(work: Path, seconds: float) -> None:
    """Remember the least time of a sample."""
    least = min(seconds, _seconds(work))
    with paths.replacing(work / "seconds.txt") as path:
        path.write_text(repr(least))


def _seconds(work: Path) -> float:
    note = work / "seconds.txt"
    return float(note.read_text()) if note.is_file() else float("inf")

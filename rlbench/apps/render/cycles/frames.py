"""Renders the frames of a clip with Cycles: geometry of all frames, then radiance in rounds.

The worker writes single images into a work folder beside the frames. A frame is assembled once all
its images exist and its reference is good enough; images that exist are not rendered again. Passes
are converted to the conventions of a clip. Geometry is rendered with sample 0 alone, which Cycles
sends through pixel centres, and which is the only sample to write depth. Verified against analytic
scenes with Blender 4.5.15.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.cycles.process import (
    CyclesParameters,
    ImageTask,
    image_seed,
    render_job,
    run_worker,
)
from rlbench.apps.render.cycles.scene_file import BlenderScene
from rlbench.apps.render.jobs import references
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.scene import Pose, Scene
from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import write_frame
from rlbench.system import store

SAMPLES_PER_IMAGE = 32  # of a reference: an interruption loses at most so many
WORK_FOLDER = ".cycles"  # beside the frames, until all are complete
LAYER = "view"  # the worker's name for the view layer
BACKGROUND_DEPTH = 1e9  # Cycles writes 1e10 for background
MIN_NORMAL_LENGTH = 0.1  # shorter normals are background
GEOMETRY = [
    *(f"{LAYER}.Denoising Albedo.{c}" for c in "RGB"),
    *(f"{LAYER}.Normal.{c}" for c in "XYZ"),
    f"{LAYER}.Depth.Z",
    *(f"{LAYER}.Vector.{c}" for c in "XY"),
]
COMBINED = [f"{LAYER}.Combined.{c}" for c in "RGB"]


@dataclass(frozen=True)
class CyclesJob:
    """One clip that Cycles renders."""

    job: Job
    file: Path
    blender_scene: BlenderScene
    parameters: CyclesParameters

    @property
    def work_folder(self) -> Path:
        """Where the worker's images are until their frame is complete."""
        return self.job.folder / WORK_FOLDER

    def render_images(
        self,
        images: list[ImageTask],
        log: Path,
        geometry: bool = False,
        size: tuple[int, int] | None = None,
    ) -> Iterator[tuple[Path, float]]:
        """Render the images that do not exist; yields each file and its seconds when written.

        `size` replaces the height and width of the clip.
        """
        missing = [image for image in images if not image.file.is_file()]
        if not missing:
            return
        preset, scene = self.job.preset, self.job.scene
        worker_job = render_job(
            self.file,
            scene,
            self.blender_scene.start,
            preset.frames,
            size or preset.size,
            self.parameters,
            missing,
            geometry,
        )
        for event in run_worker(worker_job, log):
            if event.get("event") == "made":
                yield Path(event["file"]), event["seconds"]


def render_frames(cycles_job: CyclesJob) -> Iterator[int]:
    """Render and write the missing frames; yields samples per pixel as they are finished."""
    job, folder = cycles_job.job, cycles_job.work_folder
    geometry = [
        ImageTask(_geometry_file(folder, index), index, image_seed(index, "path", 0))
        for index in job.missing_frames
    ]
    for _ in cycles_job.render_images(geometry, folder / "geometry.log", geometry=True):
        pass
    for rounds in range(1, job.preset.max_reference_rounds + 1):
        images = {
            index: _radiance_images(cycles_job, index, rounds) for index in job.missing_frames
        }
        for index in images:
            _finish_frame(cycles_job, index, rounds)
        tasks = [image for index in job.missing_frames for image in images[index]]
        by_file = {task.file: (task.frame, task.spp) for task in tasks}
        yield sum(task.spp for task in tasks if task.file.is_file()) if rounds == 1 else 0
        for file, seconds in cycles_job.render_images(tasks, folder / f"round{rounds}.log"):
            index, spp = by_file[file]
            if file.name.startswith("reference"):
                _record_seconds(folder, seconds / spp)
            _finish_frame(cycles_job, index, rounds)
            yield spp


def reference_images(
    folder: Path, stream: str, index: int, number: int, total: int
) -> list[ImageTask]:
    """The images that one round adds to one half of a reference: samples 1 to total of one seed."""
    name, seed = f"{stream}.{index:04d}.{number}", image_seed(index, stream, number)
    return [
        ImageTask(
            folder / f"{name}.{first}.exr",
            index,
            seed,
            min(SAMPLES_PER_IMAGE, total - first + 1),
            first,
            total,
        )
        for first in range(1, total + 1, SAMPLES_PER_IMAGE)
    ]


def fastest_sample_s(folder: Path) -> float:
    """The least seconds per frame at one sample per pixel so far; inf if none was measured."""
    return float(store.read_text(folder / "seconds.txt") or "inf")


def _record_seconds(folder: Path, seconds: float) -> None:
    """Keep the least time of a sample."""
    least = min(seconds, fastest_sample_s(folder))
    store.write_text(folder / "seconds.txt", repr(least))


def _radiance_images(cycles_job: CyclesJob, index: int, rounds: int) -> list[ImageTask]:
    """The radiance images of a frame up to a round: the pool, then both halves."""
    preset, folder = cycles_job.job.preset, cycles_job.work_folder.absolute()
    images = [
        ImageTask(folder / f"path.{index:04d}.{slot}.exr", index, image_seed(index, "path", slot))
        for slot in range(preset.pool_spp)
    ]
    for half in references.HALVES:
        for number in range(rounds):
            images += reference_images(
                folder, f"reference{half}", index, number, preset.reference_spp
            )
    return images


def _finish_frame(cycles_job: CyclesJob, index: int, rounds: int) -> None:
    """Write a frame if all its images exist, and if its reference is good enough or the last."""
    job, preset = cycles_job.job, cycles_job.job.preset
    images = _radiance_images(cycles_job, index, rounds)
    if not all(image.file.is_file() for image in images):
        return
    a, b = (_mean_radiance(images, half, preset.size) for half in references.HALVES)
    ceiling_db = references.noise_ceiling_db(a, b, job.scene.exposure)
    if rounds < preset.max_reference_rounds and ceiling_db < preset.min_noise_ceiling_db:
        return
    file = _geometry_file(cycles_job.work_folder, index)
    gbuffer = read_gbuffer(file, job.scene, index, preset.size)
    samples = [image for image in images if image.file.name.startswith("path.")]
    pool = np.stack([read_radiance(image.file, preset.size) for image in samples])
    if preset.max_reference_rounds > 1:
        references.write_spp(job.folder, index, 2 * preset.reference_spp * rounds)
    gbuffer = {name: gbuffer[name] for name in job.buffers}
    write_frame(job.folder, index, gbuffer, {"path": pool}, a, b)
    for image in images:
        image.file.unlink()
    file.unlink()


def _mean_radiance(
    images: list[ImageTask], half: str, size: tuple[int, int]
) -> Float[Array, "h w 3"]:
    """The mean of all samples of one half of a reference, in float32."""
    own = [image for image in images if image.file.name.startswith(f"reference{half}.")]
    sums = [read_radiance(image.file, size) * np.float64(image.spp) for image in own]
    total = np.sum(sums, axis=0) / sum(image.spp for image in own)
    return np.asarray(total.astype(np.float32))


def _geometry_file(folder: Path, index: int) -> Path:
    return folder.absolute() / f"view.{index:04d}.exr"


def read_gbuffer(
    file: Path, scene: Scene, index: int, size: tuple[int, int]
) -> dict[str, Float[Array, "h w channels"]]:
    """The G-buffer of frame `index` from its geometry file. Raises ClipError if it is broken."""
    return convert_passes(read_exr(file, GEOMETRY, *size).astype(np.float32), scene, float(index))


def convert_passes(
    planes: Float[Array, "9 h w"], scene: Scene, time: float
) -> dict[str, Float[Array, "h w channels"]]:
    """The G-buffer from the channels GEOMETRY, float32, in the conventions of `GBuffer`.

    Albedo is Cycles' denoising albedo, which follows mirrors and glass; it is clipped to [0, 1],
    because it contains the emission of emitters, and is 0 for background. Normals are normalized.
    Depth is already along the view axis; background becomes +inf. Cycles' Vector is (previous -
    current) with y up, so y is negated; it is 0 for background, whose motion is computed from the
    camera's rotation.
    """
    albedo, normal, depth, vector = np.split(np.moveaxis(planes, 0, -1), [3, 6, 7], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    empty = (depth > BACKGROUND_DEPTH) | (length < MIN_NORMAL_LENGTH)
    motion = vector * np.array([1, -1], np.float32)
    sky = sky_motion(scene, time, *empty.shape[:2])
    unit_normal = normal / np.maximum(length, MIN_NORMAL_LENGTH)
    return {
        "albedo": np.where(empty, 0, np.clip(np.nan_to_num(albedo), 0, 1)).astype(np.float32),
        "normal": np.where(empty, 0, unit_normal).astype(np.float32),
        "depth": np.where(empty, np.inf, depth).astype(np.float32),
        "motion": np.where(empty, sky, motion).astype(np.float32),
    }


def sky_motion(scene: Scene, time: float, height: int, width: int) -> Float[Array, "h w 2"]:
    """Motion vectors of points at infinity, in pixels, from the camera alone."""
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    directions = Pose.at_time(scene, time).ray_directions(film, height, width)
    points = np.column_stack([directions, np.zeros(len(film))])
    previous, _ = Pose.at_time(scene, time - 1).project(points, height, width)
    return np.asarray(previous - film).reshape(height, width, 2)


def read_radiance(file: Path, size: tuple[int, int]) -> Float[Array, "h w 3"]:
    """Linear radiance of an image, float32. Raises ClipError if the file is broken."""
    return np.moveaxis(read_exr(file, COMBINED, *size).astype(np.float32), 0, -1)

"""Renders a user's Blender, USD, glTF or FBX scene as a clip with Cycles.

The worker runs three kinds of job, each in a process of its own: small images for the exposure,
the geometry of all frames, then radiance. Finished images are kept, so an interrupted rendering
resumes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rlbench.apps.render.cycles.frames import (
    CyclesJob,
    fastest_sample_s,
    read_radiance,
    render_frames,
)
from rlbench.apps.render.cycles.process import (
    CyclesParameters,
    ImageTask,
    export_job,
    image_seed,
    run_worker,
)
from rlbench.apps.render.cycles.scene_file import open_blender_file
from rlbench.apps.render.gltf.document import FORMATS as GLTF
from rlbench.apps.render.gltf.read_scene import read_gltf
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Camera, SceneError
from rlbench.apps.render.user.clip import CameraPath, UserSceneOptions, describe_job, plan_clip
from rlbench.apps.render.user.sky import add_sky, radiance_of
from rlbench.clips.exposure import area_luminance, exposure_from_areas
from rlbench.clips.header import write_header
from rlbench.clips.presets import Preset
from rlbench.system import paths, store
from rlbench.system.progress import LoggedProgress

PREVIEW_SIZE = (32, 32)  # pixels of the images for the exposure: 8 x 8 areas of 4 x 4
PREVIEW_SPP = 16


def ensure_cycles(
    options: UserSceneOptions,
    preset: Preset,
    on_message: Callable[[str], None] = lambda message: None,
) -> Path:
    """The clip folder of a scene file that Cycles renders, after rendering the missing frames.

    Works like `ensure_user_clip`; the default camera is the file's own.
    Raises SceneError if the scene cannot be rendered with these options, ClipError if `out` holds
    frames of another renderer, and CyclesError if Blender is missing or failed.
    """
    if options.sky:
        world = ("world", str(_white_sky(options.sky)))
        options = replace(options, parameters=(*options.parameters, world), sky="")
    parameters = CyclesParameters.parse(options.parameters)
    if preset.radiance_cap < np.inf:
        raise SceneError(
            f"preset {preset.name} has a radiance cap, but samples of Cycles are not capped. Use a "
            "preset without a cap"
        )
    scene_file = open_blender_file(options, options.frames or preset.frames, parameters)
    job, path = plan_clip(options, scene_file.user_scene, preset)
    if job.is_finished:
        return job.folder
    for note in scene_file.user_scene.notes:
        on_message(note)
    job = replace(job, scene=replace(job.scene, inspector=None))  # Mitsuba's way of looking at it
    if path.kind == "wander":
        scene = replace(job.scene, camera=_wander(options.file, path, job))
        job = replace(job, scene=scene)
    if path.kind in ("orbit", "dolly"):
        if not scene_file.distance:
            raise SceneError(
                f"the camera of {options.file} sees no surface in the middle of the image to move "
                "around. Use --camera still, or a JSON file of matrices"
            )
        scene = replace(job.scene, camera=path.move_around(scene_file.distance, job.preset.frames))
        job = replace(job, scene=scene)
    cycles_job = CyclesJob(job, options.file, scene_file, parameters)
    estimate = _estimate_exposure(cycles_job)
    job = replace(job, scene=replace(job.scene, exposure=options.exposure or estimate))
    on_message(describe_job(job))
    _render(replace(cycles_job, job=job))
    return job.folder


def _white_sky(sky: str) -> float:
    """The radiance of a sky. Raises SceneError for any that is not white."""
    radiance = radiance_of(sky)
    if radiance is None:
        raise SceneError(
            f"--sky {sky}: Cycles takes a white sky alone, such as --sky 1. Make others in the file"
        )
    return radiance


def _wander(file: Path, path: CameraPath, job: Job) -> Callable[[float], Camera]:
    """The pinhole on a random path, which Mitsuba finds in the meshes that Blender exports."""
    with TemporaryDirectory(prefix="rlbench-") as folder:
        exported = file
        if file.suffix.lower() not in GLTF:
            exported = Path(folder, "meshes.glb")
            for _ in run_worker(export_job(file, exported), Path(folder, "export.log")):
                pass
        select_variant()
        scene = add_sky(read_gltf(exported).scene, "1")
        return path.choose_camera(open_tracer(scene, *job.preset.size), job.preset.frames)


def _estimate_exposure(cycles_job: CyclesJob) -> float:
    """The exposure from small images of all frames. Raises SceneError if one of them is black."""
    log = paths.cache_folder() / "cycles" / f"{cycles_job.job.name}.log"
    with TemporaryDirectory(prefix="rlbench-") as folder:
        previews = [
            ImageTask(
                Path(folder, f"{index}.exr"),
                index,
                image_seed(index, "pilot", 0),
                PREVIEW_SPP,
                1,
                PREVIEW_SPP,
            )
            for index in range(cycles_job.job.preset.frames)
        ]
        for _ in cycles_job.render_images(previews, log, size=PREVIEW_SIZE):
            pass
        images = [read_radiance(preview.file, PREVIEW_SIZE) for preview in previews]
    areas = np.stack([area_luminance(image) for image in images])
    if black := [str(index) for index, frame in enumerate(areas) if not frame.any()]:
        raise SceneError(
            f"frames {', '.join(black[:8])} are black: there is no light, none reaches what the "
            "camera sees, or the camera is inside an object. --define world=1 adds a white sky; "
            "glTF and FBX do not carry every kind of lamp"
        )
    return exposure_from_areas(areas)


def _render(cycles_job: CyclesJob) -> None:
    """Render the missing frames, then write the header."""
    job, work_folder = cycles_job.job, cycles_job.work_folder
    job.claim_folder()
    _claim_work_folder(cycles_job)
    preset, blender = job.preset, cycles_job.blender_scene.blender
    columns = LoggedProgress.get_default_columns()
    with LoggedProgress(*columns, speed_estimate_period=120) as bar:
        area = preset.size[0] * preset.size[1]
        paths_to_trace = len(job.missing_frames) * preset.paths_per_frame
        bar.console.print(
            f"rendering {job.name} with Cycles (Blender {blender}) to {job.folder}: "
            f"at most {paths_to_trace / 1e6:.2f} million light paths. "
            "If interrupted, the same command resumes it"
        )
        task = bar.add_task(job.name, total=paths_to_trace)
        for spp in render_frames(cycles_job):
            bar.advance(task, spp * area)
    version = f"Blender {blender}, {job.scene.max_depth - 2} bounces, light tree"
    seconds = fastest_sample_s(work_folder)
    sample_ms = seconds * 1e3 if np.isfinite(seconds) else float("nan")
    if not job.is_finished:  # a header of more frames stays
        write_header(job.folder, job.make_header("cycles", version, sample_ms, stratified=True))
    shutil.rmtree(work_folder)


def _claim_work_folder(cycles_job: CyclesJob) -> None:
    """Empty the work folder unless it belongs to this very clip."""
    key_file = cycles_job.work_folder / "mark.txt"
    key = cycles_job.job.content_key
    if store.read_text(key_file) != key:
        shutil.rmtree(cycles_job.work_folder, ignore_errors=True)
        store.write_text(key_file, key)

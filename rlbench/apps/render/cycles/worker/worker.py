"""Runs a job in Blender: opens a scene, describes it, and renders frames to EXR files.

SPDX-License-Identifier: GPL-3.0-or-later

This file imports bpy, which is Blender and GPL; see LICENSE and README.md beside it. It runs in its
own process, `python -I worker.py job.json`, and needs nothing but bpy. Events go to standard
output, one JSON object per line: hello, opened, placed, made (one for each file), done, or error.
Blender's output goes to standard error. README.md describes the job.

The camera's matrices are camera-to-world in Blender's convention: it looks along -z, y is up, x is
to the right. Frame i of a job is frame start + i of the scene; matrices cover -1, 0, ... frames.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

EVENTS = os.dup(1)
os.dup2(2, 1)  # Blender prints to the file descriptor of the events


class JobError(Exception):
    """A job that cannot be rendered; the message is for the user."""


def tell(event: str, **facts: Any) -> None:
    """Send one event. If the reader is gone, the process ends."""
    os.write(EVENTS, (json.dumps({"event": event, **facts}) + "\n").encode())


def load(file: Path) -> None:
    """Open or import a scene file; Python scripts in it are not run."""
    kind = file.suffix.lower()
    if kind == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False, use_scripts=False)
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    importers = {
        ".glb": "import_scene.gltf",
        ".gltf": "import_scene.gltf",
        ".fbx": "wm.fbx_import",
        ".obj": "wm.obj_import",
        **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "wm.usd_import"),
    }
    if kind not in importers:
        raise JobError(
            f"{file} has an unknown format; known formats: .blend, {', '.join(importers)}"
        )
    group, _, name = importers[kind].partition(".")
    more = {"anim_offset": 0.0} if kind == ".fbx" else {}  # otherwise animations begin a frame late
    if "FINISHED" not in getattr(getattr(bpy.ops, group), name)(filepath=str(file), **more):
        raise JobError(f"Blender could not import {file}; see its log")
    for item in bpy.data.objects:
        _awaken(item)


def _awaken(item: Any) -> None:
    """If no animation is active, play the one that the glTF importer left in a muted track."""
    for owner in (item, getattr(item.data, "shape_keys", None)):
        data = owner.animation_data if owner else None
        if not data or data.action:
            continue
        for strip in (strip for track in data.nla_tracks for strip in track.strips if strip.action):
            data.action = strip.action
            if strip.action_slot:
                data.action_slot = strip.action_slot
            return


def render(scene: Any, plan: dict[str, Any], geometry: bool, start: int) -> None:
    """Render one image.

    Radiance excludes sample 0, which goes through pixel centres for every seed. Geometry uses
    sample 0 alone, because no other sample writes depth. The sampling pattern depends on `total`,
    so it is equal for all images of one seed.
    """
    file = Path(plan["file"])
    part = file.with_name(f".part.{file.name}")
    cycles = scene.cycles
    if not geometry and plan["first"] < 1:
        raise JobError(
            "an image of sample 0 has no anti-aliasing and does not converge; start at sample 1"
        )
    cycles.seed, cycles.samples = plan["seed"], 1 if geometry else 1 + plan["total"]
    cycles.use_sample_subset = not geometry
    cycles.sample_offset = 0 if geometry else plan["first"]
    cycles.sample_subset_length = 1 if geometry else plan["spp"]
    scene.frame_set(start + plan["frame"])
    scene.render.filepath = str(part)
    begun = time.perf_counter()
    bpy.ops.render.render(write_still=True, scene=scene.name)
    if not part.is_file():
        raise JobError(f"Blender wrote no image for frame {plan['frame']}; see its log")
    part.replace(file)
    tell("made", file=plan["file"], seconds=time.perf_counter() - begun)


def work(job: dict[str, Any]) -> None:
    """Open the scene, then describe it, place cameras in it, or render the images of the job."""
    tell("hello", blender=bpy.app.version_string)
    file = Path(job["scene"])
    load(file)
    scene = bpy.context.scene
    start = blender_scene.first_frame(scene, file) if job["start"] is None else job["start"]
    if job.get("wander"):
        tell("placed", **blender_wander.place_paths(scene, job["wander"], start))
        return
    if job.get("export"):
        scene.frame_set(start)
        bpy.ops.export_scene.gltf(
            filepath=job["export"],
            export_format="GLB",
            export_apply=True,
            export_materials="NONE",
            export_animations=False,
            use_renderable=True,
        )
        return
    if not job["renders"]:
        tell("opened", **blender_scene.describe(scene, job, start))
        return
    blender_settings.prepare(scene, job)
    blender_settings.aim(scene, job["camera"], start)
    for plan in job["renders"]:
        render(scene, plan, job["geometry"], start)


if __name__ == "__main__":
    try:
        sys.path.insert(0, str(Path(__file__).parent))  # -I leaves it out
        import blender_scene
        import blender_settings
        import blender_wander
        import bpy
    except ImportError as missing:
        tell("error", kind="missing", message=str(missing))
        sys.exit(3)
    try:
        work(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    except BrokenPipeError:
        sys.exit(4)
    except Exception as error:
        kind = "job" if isinstance(error, JobError | RuntimeError) else "defect"
        traceback.print_exc()
        tell("error", kind=kind, message=str(error).strip())
        sys.exit(5)
    tell("done")

"""Blender, run by a job file: opens a scene, says what is in it, renders frames into EXR files.

SPDX-License-Identifier: GPL-3.0-or-later

This file imports bpy, which is Blender and GPL; see LICENSE and README.md beside it. It runs in a
process of its own, `python -I worker.py job.json`, and needs nothing but bpy. Events go to standard
output, one JSON object a line: hello, opened, made (one for each file), done, or error. Whatever
Blender prints goes to standard error. The job is described in README.md.

The camera's matrices are camera-to-world in Blender's convention: it looks along -z, y is up, x is
to the right. Frame i of a job is frame start + i of the scene; matrices are for -1, 0, ... frames.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import sys
import time
import traceback
from pathlib import Path
from typing import Any

EVENTS = os.dup(1)
os.dup2(2, 1)  # Blender prints where events would go

LAYER = "view"  # the prefix of every channel
GRID = 12  # rays along each side of the picture's middle quarter, for its distance
SIMULATED = {"CLOTH", "FLUID", "SOFT_BODY", "DYNAMIC_PAINT", "OCEAN", "EXPLODE", "NODES"}
CACHED = {"MESH_SEQUENCE_CACHE", "MESH_CACHE", "PARTICLE_SYSTEM", "PARTICLE_INSTANCE"}

# Cycles, made to give independent, unbiased, unfiltered samples; what each is for is in README.md
CYCLES = {
    "device": "CPU",
    "sampling_pattern": "TABULATED_SOBOL",
    "use_animated_seed": False,
    "auto_scrambling_distance": False,
    "scrambling_distance": 1.0,
    "pixel_filter_type": "BOX",
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "time_limit": 0.0,
    "use_auto_tile": False,
    "use_guiding": False,
    "use_fast_gi": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "blur_glossy": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "light_sampling_threshold": 0.0,
    "use_light_tree": True,
    "min_light_bounces": 0,
    "min_transparent_bounces": 0,
    "film_exposure": 1.0,
    "film_transparent_glass": False,
    "use_layer_samples": "IGNORE",
}
RENDER = {
    "engine": "CYCLES",
    "use_motion_blur": False,  # with it, the Vector pass is zero
    "use_persistent_data": False,  # with it, passes that change crash, and seeds change meaning
    "use_compositing": False,
    "use_sequencer": False,
    "use_freestyle": False,
    "use_multiview": False,
    "use_border": False,
    "film_transparent": False,
    "resolution_percentage": 100,
    "pixel_aspect_x": 1.0,
    "pixel_aspect_y": 1.0,
    "dither_intensity": 0.0,
    "use_file_extension": False,
    "use_overwrite": True,
    "use_placeholder": False,
}


class JobError(Exception):
    """A scene that cannot be rendered as asked; its message is for the user."""


def tell(event: str, **facts: Any) -> None:
    """One event. If nobody listens any more, the process ends."""
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
        raise JobError(f"{file} is of no known format; known are .blend, {', '.join(importers)}")
    group, _, name = importers[kind].partition(".")
    more = {"anim_offset": 0.0} if kind == ".fbx" else {}  # or animations begin a frame late
    if "FINISHED" not in getattr(getattr(bpy.ops, group), name)(filepath=str(file), **more):
        raise JobError(f"Blender could not import {file}; its log says why")
    for item in bpy.data.objects:
        _awaken(item)


def _awaken(item: Any) -> None:
    """Play the animation that the glTF importer left in a muted track, where none is active."""
    for owner in (item, getattr(item.data, "shape_keys", None)):
        data = owner.animation_data if owner else None
        if not data or data.action:
            continue
        for strip in (strip for track in data.nla_tracks for strip in track.strips if strip.action):
            data.action = strip.action
            if strip.action_slot:
                data.action_slot = strip.action_slot
            return


def first_frame(scene: Any, file: Path) -> int:
    """Where a scene begins: as it says, or where the first key is in a format without a range."""
    starts = [action.frame_range[0] for action in bpy.data.actions]
    if file.suffix.lower() in (".glb", ".gltf", ".fbx") and starts:
        return int(math.floor(min(starts)))
    return int(scene.frame_start)


def describe(scene: Any, job: dict[str, Any], start: int) -> dict[str, Any]:
    """What the scene is: its camera's path, what moves, what lights it, which files it lacks."""
    camera = scene.camera or next((o for o in scene.objects if o.type == "CAMERA"), None)
    film = (scene.render.resolution_y, scene.render.resolution_x)
    height, width = job["size"] or film
    path = _path(scene, camera, job["frames"], start, (height, width))
    scene.frame_set(start)
    meshes = [item for item in scene.objects if item.type == "MESH"]
    needed = {path: os.path.isfile(path) for path in map(str, _files())}
    return {
        "start": start,
        "end": int(scene.frame_end),
        "fps": scene.render.fps / scene.render.fps_base,
        "film": film,
        "camera": path,
        "focus": bool(camera and camera.type == "CAMERA" and camera.data.dof.use_dof),
        "distance": _distance(scene, path, start) if camera else None,
        "moves": _moves(scene, camera),
        "meshes": len(meshes),
        "lights": sum(item.type == "LIGHT" for item in scene.objects),
        "max_bounces": int(scene.cycles.max_bounces),
        "files": sorted(needed),
        "missing": sorted(path for path, there in needed.items() if not there),
    }


def _path(
    scene: Any, camera: Any, frames: int, start: int, size: tuple[int, int]
) -> dict[str, Any]:
    """The camera from frame -1: matrices, horizontal views in degrees, largest lens shift."""
    path: dict[str, Any] = {"matrices": [], "fov": [], "lens": "none", "shift": 0.0}
    if not camera:
        return path
    path["lens"] = camera.data.type
    for index in range(-1, frames + 1):
        scene.frame_set(start + index)
        graph = bpy.context.evaluated_depsgraph_get()
        found = camera.evaluated_get(graph)
        lens = found.calc_matrix_camera(graph, x=size[1], y=size[0])
        path["matrices"].append([list(row) for row in found.matrix_world.normalized()])
        path["fov"].append(math.degrees(2 * math.atan(1 / lens[0][0])))
        path["shift"] = max(path["shift"], abs(lens[0][2]), abs(lens[1][2]))
    return path


def _files() -> set[str]:
    """Files that the scene refers to and does not hold itself."""
    images = [i for i in bpy.data.images if i.source == "FILE" and i.filepath and not i.packed_file]
    parts = [*images, *bpy.data.libraries, *bpy.data.cache_files]
    return {
        os.path.realpath(bpy.path.abspath(part.filepath, library=part.library)) for part in parts
    } - {""}


def _moves(scene: Any, camera: Any) -> bool:
    """May anything but the camera change with time? Yes where that cannot be ruled out."""
    parts = [
        getattr(bpy.data, name)
        for name in ("objects", "meshes", "curves", "lights", "materials", "worlds", "armatures")
    ] + [bpy.data.shape_keys, bpy.data.node_groups, bpy.data.collections]
    owners = [item for part in parts for item in part]
    owners += [tree for item in owners if (tree := getattr(item, "node_tree", None))]
    own = {camera, camera.data} if camera else set()
    for data in (item.animation_data for item in owners if item not in own):
        if data and (data.action or data.drivers or data.nla_tracks):
            return True
    for item in scene.objects:
        if any(m.type in SIMULATED | CACHED for m in item.modifiers):
            return True
        if any(c.type == "TRANSFORM_CACHE" for c in item.constraints):
            return True
    film = any(image.source in ("MOVIE", "SEQUENCE") for image in bpy.data.images)
    return film or scene.rigidbody_world is not None


def _distance(scene: Any, path: dict[str, Any], start: int) -> float | None:
    """Median distance of what the middle quarter of the first picture shows, if it shows any."""
    matrix = mathutils.Matrix(path["matrices"][1])
    slope = math.tan(math.radians(path["fov"][1]) / 2) / 2
    scene.frame_set(start)
    graph = bpy.context.evaluated_depsgraph_get()
    lengths = []
    for x in range(GRID):
        for y in range(GRID):
            leaning = (((v + 0.5) / GRID * 2 - 1) * slope for v in (x, y))
            towards = (matrix.to_3x3() @ mathutils.Vector((*leaning, -1))).normalized()
            hit, place, *_ = scene.ray_cast(graph, matrix.translation, towards)
            if hit:
                lengths.append((place - matrix.translation).length)
    return statistics.median(lengths) if lengths else None


def prepare(scene: Any, job: dict[str, Any]) -> None:
    """Settings for all renders of a job; there are no others, so that none can leak into one."""
    for group, settings in ((scene.cycles, CYCLES), (scene.render, RENDER)):
        for name, value in settings.items():
            setattr(group, name, value)
    bounces = job["max_bounces"] if job["max_bounces"] is not None else scene.cycles.max_bounces
    for kind in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(scene.cycles, f"{kind}_bounces", bounces)
    scene.render.resolution_y, scene.render.resolution_x = job["size"]
    if job["threads"]:
        scene.render.threads_mode, scene.render.threads = "FIXED", job["threads"]
    if job["world"] is not None:
        scene.world = _white(job["world"])
    output = scene.render.image_settings
    output.file_format, output.color_depth = "OPEN_EXR_MULTILAYER", "32"
    output.exr_codec = "ZIP"
    _passes(scene, job["geometry"])


def _white(strength: float) -> Any:
    world = bpy.data.worlds.new("rlbench")
    world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs[0].default_value = (1, 1, 1, 1)
    background.inputs[1].default_value = strength
    return world


def _passes(scene: Any, geometry: bool) -> None:
    """Radiance only, or all that a view needs, in one layer; the same in all renders of a job."""
    kept, *others = scene.view_layers
    for layer in others:
        layer.use = False
    kept.use, kept.name = True, LAYER
    for group in (kept, kept.cycles):
        for name in (p.identifier for p in group.bl_rna.properties):
            if name.startswith("use_pass_") and name != "use_pass_combined":
                setattr(group, name, False)
    kept.use_pass_z = kept.use_pass_normal = kept.use_pass_vector = geometry
    kept.cycles.denoising_store_passes = geometry


def aim(scene: Any, path: dict[str, Any], start: int) -> None:
    """Replace the camera by a pinhole that goes through `path`, with keys, as Vector needs."""
    data = bpy.data.cameras.new("rlbench")
    item = bpy.data.objects.new("rlbench", data)
    scene.collection.objects.link(item)
    item.rotation_mode, data.sensor_fit = "QUATERNION", "HORIZONTAL"
    data.clip_start, data.clip_end = 1e-4, 1e6
    for index, (rows, fov) in enumerate(zip(path["matrices"], path["fov"], strict=True)):
        matrix = mathutils.Matrix(rows)
        item.location, item.rotation_quaternion = matrix.to_translation(), matrix.to_quaternion()
        data.lens = data.sensor_width / (2 * math.tan(math.radians(fov) / 2))
        for owner, name in ((item, "location"), (item, "rotation_quaternion"), (data, "lens")):
            owner.keyframe_insert(name, frame=start - 1 + index)
    scene.camera = item


def render(scene: Any, plan: dict[str, Any], geometry: bool, start: int) -> None:
    """One picture. Sample 0 goes through pixel centres, whatever the seed: so radiance has none.

    Geometry is of sample 0 alone, for depth is written by no other. Which pattern samples follow
    depends on `total`, so it is the same for all pictures that belong together.
    """
    file = Path(plan["file"])
    part = file.with_name(f".part.{file.name}")
    cycles = scene.cycles
    if not geometry and plan["first"] < 1:
        raise JobError("a picture of sample 0 has no anti-aliasing and does not converge")
    cycles.seed, cycles.samples = plan["seed"], 1 if geometry else 1 + plan["total"]
    cycles.use_sample_subset = not geometry
    cycles.sample_offset = 0 if geometry else plan["first"]
    cycles.sample_subset_length = 1 if geometry else plan["spp"]
    scene.frame_set(start + plan["frame"])
    scene.render.filepath = str(part)
    begun = time.perf_counter()
    bpy.ops.render.render(write_still=True, scene=scene.name)
    if not part.is_file():
        raise JobError(f"Blender wrote no picture for frame {plan['frame']}; its log says why")
    part.replace(file)
    tell("made", file=plan["file"], seconds=time.perf_counter() - begun)


def work(job: dict[str, Any]) -> None:
    """Open, say what is there, and render what is asked for."""
    tell("hello", blender=bpy.app.version_string)
    file = Path(job["scene"])
    load(file)
    scene = bpy.context.scene
    start = first_frame(scene, file) if job["start"] is None else job["start"]
    if not job["renders"]:
        tell("opened", **describe(scene, job, start))
        return
    prepare(scene, job)
    aim(scene, job["camera"], start)
    for plan in job["renders"]:
        render(scene, plan, job["geometry"], start)


if __name__ == "__main__":
    try:
        import bpy
        import mathutils
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

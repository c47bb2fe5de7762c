"""Describes a scene in Blender: camera, motion, light, and the files it needs.

SPDX-License-Identifier: GPL-3.0-or-later
"""

from __future__ import annotations

import math
import os
import statistics
from pathlib import Path
from typing import Any

import bpy
import mathutils

GRID = 12  # rays along each side of the image's middle quarter, which measure its distance
SIMULATED = {"CLOTH", "FLUID", "SOFT_BODY", "DYNAMIC_PAINT", "OCEAN", "EXPLODE", "NODES"}
CACHED = {"MESH_SEQUENCE_CACHE", "MESH_CACHE", "PARTICLE_SYSTEM", "PARTICLE_INSTANCE"}


def first_frame(scene: Any, file: Path) -> int:
    """The first frame of a scene: its own, or the first key in a format without a frame range."""
    starts = [action.frame_range[0] for action in bpy.data.actions]
    if file.suffix.lower() in (".glb", ".gltf", ".fbx") and starts:
        return int(math.floor(min(starts)))
    return int(scene.frame_start)


def describe(scene: Any, job: dict[str, Any], start: int) -> dict[str, Any]:
    """The scene's description: camera path, moving objects, lights, and missing files."""
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
    """The camera from frame -1 on: matrices, horizontal fov in degrees, largest lens shift."""
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
    """The external files that the scene refers to."""
    images = [i for i in bpy.data.images if i.source == "FILE" and i.filepath and not i.packed_file]
    parts = [*images, *bpy.data.libraries, *bpy.data.cache_files]
    return {
        os.path.realpath(bpy.path.abspath(part.filepath, library=part.library)) for part in parts
    } - {""}


def _moves(scene: Any, camera: Any) -> bool:
    """True if anything but the camera may change with time, or that cannot be ruled out."""
    parts = [
        getattr(bpy.data, name)
        for name in ("objects", "meshes", "curves", "lights", "materials", "worlds", "armatures")
    ] + [bpy.data.shape_keys, bpy.data.node_groups, bpy.data.collections]
    owners = [item for part in parts for item in part]
    owners += [tree for item in owners if (tree := getattr(item, "node_tree", None))]
    own = {camera, camera.data} if camera else set()
    # collections have none in Blender 4.5
    for data in (getattr(item, "animation_data", None) for item in owners if item not in own):
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
    """Median distance to the surfaces in the middle quarter of the first image, or None."""
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

"""Opens a Blender, USD, glTF or FBX file by the worker: camera, animation, and missing files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.cycles.process import (
    TESTED_BPY_VERSION,
    WORKER_VERSION,
    CyclesError,
    CyclesParameters,
    convert_axes,
    inspect_job,
    run_worker,
)
from rlbench.apps.render.scene import Camera, Scene, SceneError
from rlbench.apps.render.user import camera_path
from rlbench.apps.render.user.clip import UserSceneOptions
from rlbench.apps.render.user.scene_file import UserScene
from rlbench.system import paths, store

FORMATS = (".blend", ".usd", ".usda", ".usdc", ".usdz", ".glb", ".gltf", ".fbx", ".obj")
MAX_LENS_SHIFT = 1e-4  # fraction of the image width


@dataclass(frozen=True)
class BlenderScene:
    """A scene file as the worker describes it."""

    user_scene: UserScene
    start: int  # the scene's frame that is frame 0
    distance: float | None  # to the surface in the middle of the first image, in scene units
    blender: str  # version


def open_blender_file(
    options: UserSceneOptions, frames: int, parameters: CyclesParameters
) -> BlenderScene:
    """Open a scene file; the worker's description is cached until the files change.

    Raises SceneError for a file that does not exist, has another format, or refers to missing
    files, and CyclesError if Blender cannot open it.
    """
    file = options.file
    if file.suffix.lower() not in FORMATS:
        raise SceneError(f"Cycles cannot open {file}; it takes {', '.join(FORMATS)}")
    if not file.is_file():
        raise SceneError(f"scene file {file} does not exist; check the path")
    description = _describe(options, frames, parameters)
    if missing := description["missing"]:
        raise SceneError(
            f"{file} refers to files that do not exist: {', '.join(missing)}. Put them there, or "
            "pack them into the file"
        )
    if not description["meshes"]:
        raise SceneError(f"{file} has no mesh, so there is nothing to render. Add one")
    return BlenderScene(
        _user_scene(file, description, parameters),
        description["start"],
        description["distance"],
        description["hello"],
    )


def _describe(
    options: UserSceneOptions, frames: int, parameters: CyclesParameters
) -> dict[str, Any]:
    """The worker's description, from the cache if nothing that it depends on has changed."""
    key = f"{WORKER_VERSION} {options.file.absolute()} {frames} {options.size} {parameters.start}"
    folder = paths.cache_folder() / "cycles" / hashlib.sha256(key.encode()).hexdigest()[:16]
    cached = folder.with_suffix(".json")
    if cached.is_file():
        description: dict[str, Any] = json.loads(cached.read_text())
        if description["digest"] == hash_files(options.file, description["files"]):
            return description
    description = {}
    job = inspect_job(options.file, frames, options.size, parameters)
    for event in run_worker(job, folder / "open.log"):
        if event.get("event") == "hello":
            description["hello"] = event["blender"]
        if event.get("event") == "opened":
            description |= event
    if "start" not in description:
        raise CyclesError(
            f"Blender opened {options.file} without describing it; see {folder / 'open.log'}"
        )
    description["files"] = sorted({*description["files"], *gltf_parts(options.file)})
    description["digest"] = hash_files(options.file, description["files"])
    if not description["missing"]:
        store.write_text(cached, json.dumps(description))
    return description


def hash_files(file: Path, others: list[str]) -> str:
    """Hash of a scene file and of the files that it refers to."""
    digest = hashlib.blake2b(digest_size=16)
    for path in (file, *map(Path, others)):
        digest.update(path.name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b"missing")
    return digest.hexdigest()


def gltf_parts(file: Path) -> list[str]:
    """The buffers and images beside a .gltf file, which Blender does not list."""
    if file.suffix.lower() != ".gltf":
        return []
    content = json.loads(file.read_text(encoding="utf-8"))
    uris = [
        part.get("uri", "data:") for kind in ("buffers", "images") for part in content.get(kind, ())
    ]
    return [str((file.parent / unquote(uri)).absolute()) for uri in uris if uri[:5] != "data:"]


def _user_scene(
    file: Path, description: Mapping[str, Any], parameters: CyclesParameters
) -> UserScene:
    name, camera = file.stem, description["camera"]
    _check_lens(file, camera)
    matrices = [convert_axes(np.array(rows)) for rows in camera["matrices"]]
    is_fixed = all(np.allclose(rows, matrices[0], atol=1e-6) for rows in matrices)
    is_fixed = is_fixed and len({round(fov, 6) for fov in camera["fov"]}) < 2
    bounces = parameters.max_bounces
    bounces = description["max_bounces"] if bounces is None else bounces
    animated = _animated_camera(matrices, camera["fov"]) if matrices else _default_camera
    static = is_fixed and not description["moves"]
    scene = Scene(name, name, (), animated, max_depth=bounces + 2, static=static)
    high, wide = description["film"]
    return UserScene(
        scene,
        name,
        f"cycles {WORKER_VERSION} {description['digest']} {description['start']} "
        f"{parameters.content_key}",
        matrices[1] if matrices else None,
        camera["fov"][1] if matrices else 60.0,
        animates_camera=bool(matrices),
        has_moving_shapes=description["moves"],
        aspect=wide / high,
        notes=[f"{file.name}: {note}" for note in _notes(description)],
    )


def _check_lens(file: Path, camera: Mapping[str, Any]) -> None:
    if camera["lens"] not in ("PERSP", "none"):
        raise SceneError(
            f"{file}: its camera has the lens {camera['lens']}; rlbench needs PERSP, a pinhole"
        )
    if camera["shift"] > MAX_LENS_SHIFT:
        raise SceneError(
            f"{file}: its camera's lens is shifted; rlbench needs a centred pinhole. Set shift to 0"
        )


def _default_camera(time: float) -> Camera:
    return Camera((0, 0, 0), (0, 1, 0))


def _animated_camera(
    matrices: list[Float[Array, "4 4"]], fov: list[float]
) -> Callable[[float], Camera]:
    """The camera as a function of time; lists hold frames -1, 0, ..., in Mitsuba's convention."""

    def at(time: float) -> Camera:
        index = int(np.clip(round(time) + 1, 0, len(matrices) - 1))
        return camera_path.camera_from_matrix(matrices[index], fov[index])

    return at


def _notes(description: Mapping[str, Any]) -> list[str]:
    """Differences between the file and the rendering."""
    notes = []
    if description["focus"]:
        notes.append("depth of field is off: its camera is rendered as a pinhole")
    if description["hello"].split()[0] != TESTED_BPY_VERSION:
        notes.append(
            f"Blender {description['hello']}; rlbench was tested with {TESTED_BPY_VERSION}"
        )
    return notes

"""A Blender, USD, glTF or FBX file, opened by the worker: its camera, what moves, what it lacks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.cycles.process import VERSION, CyclesError, run_worker
from rlbench.render.cycles.worker_job import (
    WORKER_VERSION,
    CyclesParameters,
    convert_axes,
    inspect_job,
)
from rlbench.render.scene import Camera, Scene, SceneError
from rlbench.render.user import camera_path
from rlbench.render.user.clip import UserSceneOptions
from rlbench.render.user.scene_file import UserScene
from rlbench.system import paths

FORMATS = (".blend", ".usd", ".usda", ".usdc", ".usdz", ".glb", ".gltf", ".fbx", ".obj")
CENTRED = 1e-4  # share of the picture's width that the lens may be shifted by


@dataclass(frozen=True)
class BlenderScene:
    """What the worker says of a file."""

    user_scene: UserScene
    start: int  # the scene's frame that is frame 0
    distance: float | None  # to what the middle of the first picture shows, in scene units
    blender: str  # version


def open_blender_file(wish: UserSceneOptions, frames: int, asked: CyclesParameters) -> BlenderScene:
    """Ask the worker what a scene file holds; what it said is remembered while files are the same.

    Raises SceneError for a file that is not there, of another format, or that lacks files itself,
    and CyclesError where Blender cannot open it.
    """
    file = wish.file
    if file.suffix.lower() not in FORMATS:
        raise SceneError(f"Cycles cannot open {file}; it takes {', '.join(FORMATS)}")
    if not file.is_file():
        raise SceneError(f"no scene file {file}")
    facts = _remembered(wish, frames, asked)
    if lost := facts["missing"]:
        raise SceneError(
            f"{file} refers to files that are not there: {', '.join(lost)}; put them there, or "
            "pack them into the file"
        )
    if not facts["meshes"]:
        raise SceneError(f"{file} holds no mesh, so there is nothing to see")
    return BlenderScene(
        _as_opened(file, facts, asked), facts["start"], facts["distance"], facts["hello"]
    )


def _remembered(wish: UserSceneOptions, frames: int, asked: CyclesParameters) -> dict[str, Any]:
    """The worker's description, from the cache if nothing it depends on has changed."""
    words = f"{WORKER_VERSION} {wish.file.absolute()} {frames} {wish.size} {asked.start}"
    place = paths.cache() / "cycles" / hashlib.sha256(words.encode()).hexdigest()[:16]
    note = place.with_suffix(".json")
    if note.is_file():
        facts: dict[str, Any] = json.loads(note.read_text())
        if facts["digest"] == digest(wish.file, facts["files"]):
            return facts
    facts = {}
    for event in run_worker(inspect_job(wish.file, frames, wish.size, asked), place / "open.log"):
        if event.get("event") == "hello":
            facts["hello"] = event["blender"]
        if event.get("event") == "opened":
            facts |= event
    if "start" not in facts:
        raise CyclesError(f"Blender opened {wish.file} and said nothing of it")
    facts["files"] = sorted({*facts["files"], *gltf_parts(wish.file)})
    facts["digest"] = digest(wish.file, facts["files"])
    if not facts["missing"]:
        with paths.replacing(note) as path:
            path.write_text(json.dumps(facts))
    return facts


def digest(file: Path, others: list[str]) -> str:
    """Hash of a scene file and of the files that it refers to."""
    told = hashlib.blake2b(digest_size=16)
    for each in (file, *map(Path, others)):
        told.update(each.name.encode())
        told.update(hashlib.sha256(each.read_bytes()).digest() if each.is_file() else b"missing")
    return told.hexdigest()


def gltf_parts(file: Path) -> list[str]:
    """The files beside a .gltf that it consists of, which Blender forgets once they are read."""
    if file.suffix.lower() != ".gltf":
        return []
    text = json.loads(file.read_text(encoding="utf-8"))
    found = [
        part.get("uri", "data:") for kind in ("buffers", "images") for part in text.get(kind, ())
    ]
    return [str((file.parent / unquote(uri)).absolute()) for uri in found if uri[:5] != "data:"]


def _as_opened(file: Path, facts: Mapping[str, Any], asked: CyclesParameters) -> UserScene:
    name = file.stem
    path = facts["camera"]
    matrices = [convert_axes(np.array(rows)) for rows in path["matrices"]]
    fixed = all(np.allclose(rows, matrices[0], atol=1e-6) for rows in matrices)
    fixed = fixed and len({round(fov, 6) for fov in path["fov"]}) < 2
    high, wide = facts["film"]
    bounces = facts["max_bounces"] if asked.max_bounces is None else asked.max_bounces
    scene = Scene(
        name,
        name,
        (),
        flown(matrices, path["fov"]) if matrices else lambda time: Camera((0, 0, 0), (0, 1, 0)),
        depth=bounces + 2,
        static=fixed and not facts["moves"],
    )
    if path["lens"] not in ("PERSP", "none"):
        raise SceneError(f"{file}: its camera is {path['lens']}; rlbench takes PERSP, a pinhole")
    if path["shift"] > CENTRED:
        raise SceneError(f"{file}: its camera's lens is shifted; rlbench takes a centred pinhole")
    made_of = f"cycles {WORKER_VERSION} {facts['digest']} {facts['start']} {asked.content_key}"
    fov = path["fov"][1] if matrices else 60.0
    first = matrices[1] if matrices else None
    notes = [f"{file.name}: {note}" for note in _notes(facts)]
    return UserScene(
        scene, name, made_of, first, fov, bool(matrices), facts["moves"], wide / high, notes
    )


def flown(matrices: list[Float[Array, "4 4"]], fov: list[float]) -> Any:
    """The camera at a time, of matrices (Mitsuba's convention) and views of frames -1, 0, ..."""

    def at(time: float) -> Camera:
        index = int(np.clip(round(time) + 1, 0, len(matrices) - 1))
        return camera_path.camera_from_matrix(matrices[index], fov[index])

    return at


def _notes(facts: Mapping[str, Any]) -> list[str]:
    """What is rendered otherwise than the file says."""
    notes = []
    if facts["focus"]:
        notes.append("depth of field is off, its camera becomes a pinhole")
    if facts["hello"].split()[0] != VERSION:
        notes.append(f"Blender {facts['hello']}; rlbench was measured with {VERSION}")
    return notes

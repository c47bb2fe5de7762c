"""A user's scene file, opened: a Mitsuba XML, or Python that makes a scene or moves one.

A Python file defines `scene()`, which returns a `rlbench.render.scene.Scene`; or `SCENE`, the name
of an XML file beside it, and `moving(time, rest)`. `rest` maps the ids of shapes to their vertices
(float32 [v, 3], world space), `time` is in frames from 0, and what is returned maps the ids of the
shapes that move, the same for every time, to their vertices then. With `scene()`, `moving` moves
its meshes likewise.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.fingerprint import fingerprint
from rlbench.render.mitsuba import xml_scene
from rlbench.render.scene import Camera, Scene, SceneError, XmlFile
from rlbench.render.user import camera_path

Vertices = Mapping[str, Float[Array, "v 3"]]
UNSAID = re.compile(r"scene(_v\d+)?", re.IGNORECASE)  # file names that say nothing


@dataclass(frozen=True, eq=False)
class UserScene:
    """A scene, and what its file says beyond it."""

    scene: Scene
    name: str
    files_hash: str  # hash of the files
    camera_to_world: Float[Array, "4 4"] | None  # camera-to-world, as the file has it
    fov: float  # horizontal, degrees
    animates_camera: bool = False  # does the scene move its camera itself?
    has_moving_shapes: bool = False  # may shapes move?
    aspect: float = 0.0  # width over height of its film; 0 where it has none
    notes: list[str] = field(default_factory=list)  # what is rendered otherwise than it says

    def sensor_matrix(self) -> Float[Array, "4 4"]:
        """The scene's own view, camera-to-world. Raises SceneError where there is none."""
        if self.camera_to_world is None:
            raise SceneError(
                f"{self.name} has no sensor; add one, or give --camera a JSON file of matrices"
            )
        return camera_path.check_rigid(self.camera_to_world, f"{self.name}: to_world of its sensor")

    def content_hash(self, frames: int) -> str:
        """Hash of all that the scene is made of."""
        return f"{self.files_hash} {fingerprint(self.scene, frames)}"


def open_scene_file(file: Path, parameters: tuple[tuple[str, str], ...] = ()) -> UserScene:
    """Open an XML or Python file. Mitsuba must be running. Raises SceneError."""
    if not file.is_file():
        raise SceneError(f"no scene file {file}; --scene takes a Mitsuba XML or a Python file")
    if file.suffix == ".xml":
        return _from_xml(XmlFile(file, parameters))
    if file.suffix != ".py":
        raise SceneError(f"{file} is neither .xml (Mitsuba) nor .py; --scene takes one of these")
    with _told(file):
        module = _run(file)
    made_of = _bytes(file)
    hook = getattr(module, "moving", None)
    if hasattr(module, "scene"):
        if parameters:
            raise SceneError(f"{file} makes its scene itself: it has no <default> to --define")
        with _told(file):
            scene = module.scene()
        if not isinstance(scene, Scene):
            raise SceneError(f"scene() of {file} returned {type(scene).__name__}, expected Scene")
        found = _from_scene(scene, made_of)
        return _moved(found, file, hook) if hook else found
    if not (hook and isinstance(getattr(module, "SCENE", None), str)):
        raise SceneError(
            f"{file} defines neither scene(), nor SCENE (the name of an XML file) and "
            "moving(time, rest)"
        )
    found = _from_xml(XmlFile(file.parent / module.SCENE, parameters))
    found = replace(found, made_of=f"{made_of} {found.files_hash}")
    return _moved(found, file, hook)


def _from_xml(asked: XmlFile) -> UserScene:
    facts = xml_scene.read_settings(asked)
    stem = asked.path.stem
    name = asked.path.resolve().parent.name if UNSAID.fullmatch(stem) else stem
    scene = Scene(name, name, (), lambda time: Camera((0, 0, 0), (0, 1, 0)), xml_file=asked)
    scene = replace(scene, depth=facts.depth)
    return UserScene(
        scene,
        name,
        facts.digest,
        facts.matrix,
        facts.fov,
        aspect=facts.aspect,
        notes=facts.notes,
    )


def _from_scene(scene: Scene, made_of: str) -> UserScene:
    first, moves = scene.camera(0.0), not scene.static
    if scene.xml_file:
        made_of = f"{made_of} {xml_scene.read_settings(scene.xml_file).digest}"
    return UserScene(
        scene, scene.name, made_of, camera_path.matrix_from_camera(first), first.fov, True, moves
    )


def _moved(found: UserScene, file: Path, hook: Callable[..., Any]) -> UserScene:
    """`found` with the meshes that `hook` moves; at and before time 0 they are as at time 0."""
    plan = found.scene.xml_file
    meshes = (
        xml_scene.named_meshes(plan) if plan else {mesh.name: mesh for mesh in found.scene.meshes}
    )
    rest = {name: mesh.vertices for name, mesh in meshes.items()}

    def moving(time: float) -> Vertices:
        with _told(file):
            moved = hook(max(time, 0.0), {name: v.copy() for name, v in rest.items()})
        return _checked(moved, rest, f"moving({max(time, 0.0):g}, rest) of {file}")

    first = moving(0.0)

    def steady(time: float) -> Vertices:
        moved = moving(time)
        if moved.keys() != first.keys():
            raise SceneError(
                f"moving({time:g}, rest) of {file} moves {', '.join(moved) or 'nothing'}, but at "
                f"time 0 it moves {', '.join(first) or 'nothing'}; return the same shapes always"
            )
        return moved

    static = found.scene.static and not first
    scene = replace(found.scene, vertex_animation=steady, static=static)
    if scene.xml_file:
        scene = replace(scene, meshes=tuple(meshes[name] for name in first))
    return replace(found, scene=scene, moves=True)


def _checked(moved: Any, rest: Vertices, where: str) -> Vertices:
    """What a hook has returned, as float32."""
    if not isinstance(moved, Mapping):
        raise SceneError(f"{where} returned {type(moved).__name__}, expected a dict of vertices")
    if unknown := sorted(set(moved) - set(rest)):
        raise SceneError(
            f"{where} moves '{unknown[0]}'; shapes that can move are meshes with an id: "
            f"{', '.join(rest) or 'none'}"
        )
    found = {name: np.asarray(vertices, np.float32) for name, vertices in moved.items()}
    for name, vertices in found.items():
        if vertices.shape != rest[name].shape or not np.isfinite(vertices).all():
            raise SceneError(
                f"{where}: '{name}' has vertices of shape {list(vertices.shape)}, expected finite "
                f"ones of shape {list(rest[name].shape)}"
            )
    return found


def _run(file: Path) -> ModuleType:
    """The module of a Python file, which may import what lies beside it."""
    name = f"rlbench_scene_{hashlib.sha256(file.read_bytes()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise SceneError(f"{file} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(file.resolve().parent))
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.resolve().parent))
        del sys.modules[name]
    return module


def _bytes(file: Path) -> str:
    """Hash of a Python file, and of the modules beside it that have been imported."""
    loaded = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    beside = {Path(f).resolve() for f in loaded if f} | {file.resolve()}
    own = sorted(f for f in beside if f.parent == file.resolve().parent and f.is_file())
    words = hashlib.blake2b(digest_size=16)
    for each in own:
        words.update(hashlib.blake2b(each.read_bytes()).digest())
    return words.hexdigest()


@contextmanager
def _told(file: Path) -> Iterator[None]:
    """An error in a user's file as SceneError that says where in that file it was."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        here = file.resolve()
        line = next((f.lineno for f in reversed(frames) if Path(f.filename) == here), None)
        place = f"{file}, line {line}" if line else str(file)
        raise SceneError(f"{place}: {type(error).__name__}: {error}") from error

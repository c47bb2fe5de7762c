"""Opens a user's scene file: Mitsuba XML, glTF, or Python code that builds or animates a scene.

A Python file defines `scene()`, which returns a `Scene`; or `SCENE`, the name
of an XML file beside it, and `moving(time, rest)`. `rest` maps the ids of shapes to their vertices
(float32 [v, 3], world space), and `time` is in frames from 0. `moving` returns the vertices at that
time, by id, of the shapes that move; these must be the same shapes at all times. With `scene()`,
`moving` animates its meshes.
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

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.gltf import document as gltf
from rlbench.apps.render.gltf.read_scene import read_gltf
from rlbench.apps.render.mitsuba import xml_scene
from rlbench.apps.render.scene import Camera, Scene, SceneError, Vertices, XmlFile
from rlbench.apps.render.user import camera_path

GENERIC_NAME = re.compile(r"scene(_v\d+)?", re.IGNORECASE)  # then the folder names the scene


def run_file(file: Path) -> ModuleType:
    """The module of a Python file, which may import modules from its folder."""
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


def hash_modules(file: Path) -> str:
    """Hash of a Python file and of the imported modules in its folder."""
    loaded = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    modules = {Path(f).resolve() for f in loaded if f} | {file.resolve()}
    siblings = sorted(f for f in modules if f.parent == file.resolve().parent and f.is_file())
    digest = hashlib.blake2b(digest_size=16)
    for sibling in siblings:
        digest.update(hashlib.blake2b(sibling.read_bytes()).digest())
    return digest.hexdigest()


def checked_animation(
    moving: Callable[..., Any], rest: Vertices, file: Path
) -> Callable[[float], Vertices]:
    """The user's `moving` as a vertex animation whose results are checked.

    `rest` holds the vertices of all meshes that can move. Raises SceneError if `moving` fails,
    returns anything but vertices of these meshes, or moves other meshes than at time 0.
    """

    def move(time: float) -> Vertices:
        time = max(time, 0.0)
        with user_errors(file):
            moved = moving(time, {name: vertices.copy() for name, vertices in rest.items()})
        return _check_vertices(moved, rest, f"moving({time:g}, rest) of {file}")

    first = move(0.0)

    def animation(time: float) -> Vertices:
        moved = move(time)
        if moved.keys() != first.keys():
            raise SceneError(
                f"moving({time:g}, rest) of {file} moves {', '.join(moved) or 'nothing'}, but at "
                f"time 0 it moves {', '.join(first) or 'nothing'}. Return the same shapes always"
            )
        return moved

    return animation


@contextmanager
def user_errors(file: Path) -> Iterator[None]:
    """Raises an error in a user's file as SceneError with the line of that file."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        path = file.resolve()
        line = next((f.lineno for f in reversed(frames) if Path(f.filename) == path), None)
        location = f"{file}, line {line}" if line else str(file)
        raise SceneError(f"{location}: {type(error).__name__}: {error}") from error


def _check_vertices(moved: Any, rest: Vertices, source: str) -> Vertices:
    """The vertices that a user's function returned, as float32."""
    if not isinstance(moved, Mapping):
        raise SceneError(f"{source} returned {type(moved).__name__}, expected a dict of vertices")
    if unknown := sorted(set(moved) - set(rest)):
        raise SceneError(
            f"{source} moves '{unknown[0]}', which is not a mesh with an id; meshes that can move: "
            f"{', '.join(rest) or 'none'}"
        )
    converted = {name: np.asarray(vertices, np.float32) for name, vertices in moved.items()}
    for name, vertices in converted.items():
        if vertices.shape != rest[name].shape or not np.isfinite(vertices).all():
            raise SceneError(
                f"{source}: '{name}' has vertices of shape {list(vertices.shape)}, expected finite "
                f"ones of shape {list(rest[name].shape)}"
            )
    return converted


@dataclass(frozen=True, eq=False)
class UserScene:
    """A scene, with what its file specifies beyond `Scene`."""

    scene: Scene
    name: str
    files_hash: str
    camera_to_world: Float[Array, "4 4"] | None  # of the file's sensor
    fov: float  # horizontal, degrees
    animates_camera: bool = False  # does the scene animate its own camera?
    has_moving_shapes: bool = False
    aspect: float = 0.0  # width over height of the film; 0 if the file has none
    notes: list[str] = field(default_factory=list)  # differences between the file and the rendering
    missing_files: tuple[str, ...] = ()  # that are left out

    def sensor_matrix(self) -> Float[Array, "4 4"]:
        """The camera-to-world matrix of the file's sensor.

        Raises SceneError if the file has no sensor, or if its matrix is not rigid.
        """
        if self.camera_to_world is None:
            raise SceneError(
                f"{self.name} has no camera, which XML calls sensor. Add one, or use --camera "
                "wander, which finds views by itself, or a JSON file of matrices"
            )
        return camera_path.check_rigid(self.camera_to_world, f"{self.name}: to_world of its sensor")

    def content_hash(self, frames: int) -> str:
        """Hash of the files and of the scene that they describe."""
        return f"{self.files_hash} {fingerprint(self.scene, frames)}"


def open_scene_file(
    file: Path, parameters: tuple[tuple[str, str], ...] = (), skip_missing: bool = False
) -> UserScene:
    """Open an XML or Python file; a Mitsuba variant must be set.

    `parameters` replace <default> values of the XML file; with `skip_missing`, shapes and textures
    whose files do not exist are left out. Raises SceneError for a file that does
    not exist, has another format, or fails.
    """
    if not file.is_file():
        raise SceneError(
            f"scene file {file} does not exist; render takes a Mitsuba XML, glTF or Python file"
        )
    if file.suffix == ".xml":
        return _from_xml(XmlFile(file, parameters, skip_missing))
    if file.suffix.lower() in gltf.FORMATS:
        if parameters:
            raise SceneError("--define applies to XML files and to Cycles. Omit it")
        return _from_gltf(file, skip_missing)
    if file.suffix != ".py":
        raise SceneError(
            f"{file} is neither .xml (Mitsuba) nor .gltf, .glb or .py; render takes one of these"
        )
    return _from_python(file, parameters, skip_missing)


def _from_python(
    file: Path, parameters: tuple[tuple[str, str], ...], skip_missing: bool
) -> UserScene:
    with user_errors(file):
        module = run_file(file)
    files_hash = hash_modules(file)
    moving = getattr(module, "moving", None)
    if hasattr(module, "scene"):
        if parameters:
            raise SceneError(
                f"{file} builds its scene in Python: --define applies to XML files only"
            )
        with user_errors(file):
            scene = module.scene()
        if not isinstance(scene, Scene):
            raise SceneError(f"scene() of {file} returned {type(scene).__name__}, expected Scene")
        user_scene = _from_scene(scene, files_hash)
        return _animate(user_scene, file, moving) if moving else user_scene
    if not (moving and isinstance(getattr(module, "SCENE", None), str)):
        raise SceneError(
            f"{file} defines neither scene(), nor SCENE (the name of an XML file) and "
            "moving(time, rest)"
        )
    user_scene = _from_xml(XmlFile(file.parent / module.SCENE, parameters, skip_missing))
    user_scene = replace(user_scene, files_hash=f"{files_hash} {user_scene.files_hash}")
    return _animate(user_scene, file, moving)


def _from_gltf(file: Path, skip_missing: bool) -> UserScene:
    found = read_gltf(file, skip_missing)
    return UserScene(
        found.scene,
        _name(file),
        found.scene.source_hash,
        found.camera_to_world,
        found.fov,
        aspect=found.aspect,
        notes=found.notes,
        missing_files=found.scene.missing_files,
    )


def _name(file: Path) -> str:
    """The name of a file, or of its folder if it is called `scene`."""
    return file.resolve().parent.name if GENERIC_NAME.fullmatch(file.stem) else file.stem


def _from_xml(xml_file: XmlFile) -> UserScene:
    settings = xml_scene.read_settings(xml_file)
    name = _name(xml_file.path)
    matrix, notes = settings.camera_to_world, settings.notes
    if matrix is not None:
        matrix, more = camera_path.straighten(matrix)
        notes = [*notes, *more]
    scene = Scene(
        name,
        name,
        (),
        lambda time: Camera((0, 0, 0), (0, 1, 0)),
        max_depth=settings.max_depth,
        xml_file=xml_file,
    )
    return UserScene(
        scene,
        name,
        settings.digest,
        matrix,
        settings.fov,
        aspect=settings.aspect,
        notes=notes,
        missing_files=settings.missing_files,
    )


def _from_scene(scene: Scene, files_hash: str) -> UserScene:
    first = scene.camera(0.0)
    if scene.xml_file:
        files_hash = f"{files_hash} {xml_scene.read_settings(scene.xml_file).digest}"
    return UserScene(
        scene,
        scene.name,
        files_hash,
        camera_path.matrix_from_camera(first),
        first.fov,
        animates_camera=True,
        has_moving_shapes=not scene.static,
    )


def _animate(user_scene: UserScene, file: Path, moving: Callable[..., Any]) -> UserScene:
    """`user_scene` with the meshes that `moving` animates; before time 0 they stand as at 0."""
    xml_file = user_scene.scene.xml_file
    meshes = (
        xml_scene.named_meshes(xml_file)
        if xml_file
        else {mesh.name: mesh for mesh in user_scene.scene.meshes}
    )
    animation = checked_animation(
        moving, {name: mesh.vertices for name, mesh in meshes.items()}, file
    )
    first: Vertices = animation(0.0)
    static = user_scene.scene.static and not first
    scene = replace(user_scene.scene, vertex_animation=animation, static=static)
    if scene.xml_file:
        scene = replace(scene, meshes=tuple(meshes[name] for name in first))
    return replace(user_scene, scene=scene, has_moving_shapes=True)

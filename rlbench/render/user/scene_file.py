"""Opens a user's scene file: a Mitsuba XML file, or Python code that builds or animates a scene.

A Python file defines `scene()`, which returns a `rlbench.render.scene.Scene`; or `SCENE`, the name
of an XML file beside it, and `moving(time, rest)`. `rest` maps the ids of shapes to their vertices
(float32 [v, 3], world space), and `time` is in frames from 0. `moving` returns the vertices at that
time, by id, of the shapes that move; these must be the same shapes at all times. With `scene()`,
`moving` animates its meshes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.fingerprint import fingerprint
from rlbench.render.mitsuba import xml_scene
from rlbench.render.scene import Camera, Scene, SceneError, Vertices, XmlFile
from rlbench.render.user import camera_path, python_file

__all__ = ["UserScene", "open_scene_file"]

GENERIC_NAME = re.compile(r"scene(_v\d+)?", re.IGNORECASE)  # then the folder names the scene


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
                f"{self.name} has no sensor. Add one, or give --camera a JSON file of matrices"
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
            f"scene file {file} does not exist; render takes a Mitsuba XML or a Python file"
        )
    if file.suffix == ".xml":
        return _from_xml(XmlFile(file, parameters, skip_missing))
    if file.suffix != ".py":
        raise SceneError(
            f"{file} is neither .xml (Mitsuba) nor .py; render takes one of these"
        )
    return _from_python(file, parameters, skip_missing)


def _from_python(
    file: Path, parameters: tuple[tuple[str, str], ...], skip_missing: bool
) -> UserScene:
    with python_file.user_errors(file):
        module = python_file.run_file(file)
    files_hash = python_file.hash_modules(file)
    moving = getattr(module, "moving", None)
    if hasattr(module, "scene"):
        if parameters:
            raise SceneError(
                f"{file} builds its scene in Python: --define applies to XML files only"
            )
        with python_file.user_errors(file):
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


def _from_xml(xml_file: XmlFile) -> UserScene:
    settings = xml_scene.read_settings(xml_file)
    stem = xml_file.path.stem
    name = xml_file.path.resolve().parent.name if GENERIC_NAME.fullmatch(stem) else stem
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
        settings.camera_to_world,
        settings.fov,
        aspect=settings.aspect,
        notes=settings.notes,
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
    animation = python_file.checked_animation(
        moving, {name: mesh.vertices for name, mesh in meshes.items()}, file
    )
    first: Vertices = animation(0.0)
    static = user_scene.scene.static and not first
    scene = replace(user_scene.scene, vertex_animation=animation, static=static)
    if scene.xml_file:
        scene = replace(scene, meshes=tuple(meshes[name] for name in first))
    return replace(user_scene, scene=scene, has_moving_shapes=True)

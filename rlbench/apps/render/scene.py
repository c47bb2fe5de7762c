"""A scene as plain data: meshes, emitters, camera and takes, and its pose at one time.

No renderer is imported. A scene plugin is a function that returns a `Scene`, registered as an entry
point in the group `rlbench.scenes`. It has no argument, or a `seed`: the clip NAME-007 is made with
seed 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import NDArray

from rlbench.errors import RlbenchError

Vertices = Mapping[str, NDArray[np.float32]]  # [v 3] in world space, by mesh name
MitsubaDict = Mapping[str, Any]  # a Mitsuba scene dict; bitmap textures may hold numpy arrays
MIN_DEPTH = 1e-6  # m: points nearer to the camera plane, or behind it, are projected from here


@dataclass(frozen=True)
class Mesh:
    """Triangles with one BSDF.

    Merge meshes that share a BSDF: each mesh adds about 0.25 ms to every launch.
    """

    name: str
    vertices: NDArray[np.float32]  # [v 3], world space, metres, z up
    faces: NDArray[np.uint32]  # [f 3], counter-clockwise from outside
    material: MitsubaDict  # a BSDF, for example {"type": "diffuse", "reflectance": {...}}
    uv: NDArray[np.float32] | None = None  # [v 2]
    emission: MitsubaDict | None = (
        None  # an area emitter; for many lights, one mesh with a bitmap atlas
    )
    smooth: bool = False  # interpolate vertex normals?
    normals: NDArray[np.float32] | None = None  # [v 3], in place of those that `smooth` computes
    # [v c] by a name that begins with vertex_, for the textures of its material
    attributes: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at one time. Positions are in world space, in metres."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov: float = 60.0  # horizontal field of view, degrees


class Window(NamedTuple):
    """The part of a larger, virtual frame that a clip shows at one time, in pixels."""

    height: int  # of the virtual frame
    width: int
    top: int  # of the window's upper left corner
    left: int


@dataclass(frozen=True)
class XmlFile:
    """A Mitsuba XML file. Only Mitsuba reads its shapes, BSDFs and emitters."""

    path: Path
    parameters: tuple[tuple[str, str], ...] = ()  # values that replace the file's <default> values
    skip_missing: bool = False  # leave out shapes whose file is missing, and make textures grey?
    sky: str = ""  # an XML element that is added


class SceneError(RlbenchError, ValueError):
    """A scene that cannot be rendered with the given options."""


def _unchanged_lights(time: float) -> Mapping[str, float]:
    """No emitter is scaled."""
    return {}


@dataclass(frozen=True)
class Take:
    """A further clip of a scene, with its own camera and, if given, its own animation and lights.

    Everything else comes from the scene. `lights(time)` returns factors >= 0 on the radiance of
    emitters: by mesh name, or `sky0`, `sky1`, ... for `Scene.sky`. Emitters that it does not name
    are unchanged. Another shot begins at each frame in `cuts`, and the history is invalid there:
    see `rlbench.apps.render.mitsuba.gbuffer`.
    """

    name: str  # the clip is called <scene>-<name>; must not contain a hyphen
    camera: Callable[[float], Camera]
    vertex_animation: Callable[[float], Vertices] | None = None
    lights: Callable[[float], Mapping[str, float]] = _unchanged_lights
    cuts: tuple[int, ...] = ()
    static: bool = False  # neither camera nor meshes move; lights may change


@dataclass(frozen=True)
class Scene:
    """One animated scene. Time is in frames from 0; equal times always give equal poses.

    The scene itself is the main clip, `takes` are further clips. `lights` and `cuts` are documented
    in `Take`.
    """

    name: str
    title: str
    meshes: tuple[Mesh, ...]
    camera: Callable[[float], Camera]
    sky: tuple[MitsubaDict, ...] = ()  # emitters without a surface: constant, sunsky, directional
    vertex_animation: Callable[[float], Vertices] = field(
        default=lambda time: {}
    )  # vertices of the meshes that move
    lights: Callable[[float], Mapping[str, float]] = _unchanged_lights
    cuts: tuple[int, ...] = ()  # frames at which another shot begins
    takes: tuple[Take, ...] = ()
    exposure: float = 1.0  # factor on radiance after which 1.0 is display white
    max_depth: int = 8  # longest light path, in edges (Mitsuba's max_depth)
    static: bool = False  # neither camera nor meshes move
    xml_file: XmlFile | None = None  # replaces sky and all meshes but the animated ones
    source_hash: str = ""  # hash of a user's scene files; replaces the computed fingerprint
    licence: str = "Apache-2.0"  # of the rendered images
    missing_files: tuple[str, ...] = ()  # of a user's scene, whose shapes or textures are left out
    # (frames, (height, width)) -> the scene with a camera path and an exposure chosen by rays
    inspector: Callable[[int, tuple[int, int]], Scene] | None = None
    window: Callable[[float], Window] | None = None  # without one, a clip shows the whole frame

    def inspect(self, frames: int, size: tuple[int, int]) -> Scene:
        """The scene as it is rendered: with the camera path and exposure that `inspector` chooses.

        Equal arguments give equal scenes. It may take seconds. Raises SceneError if no path or no
        light is found.
        """
        return replace(self.inspector(frames, size), inspector=None) if self.inspector else self

    def at_speed(self, speed: float) -> Scene:
        """The scene with all motion `speed` times as fast; cuts and lights keep their frames."""
        if speed == 1:
            return self
        camera, animation, inspector = self.camera, self.vertex_animation, self.inspector

        def inspect(frames: int, size: tuple[int, int]) -> Scene:
            longest = math.ceil((frames - 1) * speed) + 1
            return replace(self, inspector=inspector).inspect(longest, size).at_speed(speed)

        return replace(
            self,
            camera=lambda time: camera(speed * time),
            vertex_animation=lambda time: animation(speed * time),
            inspector=inspect if inspector else None,
            source_hash=f"{self.source_hash} x{speed:g}" if self.source_hash else "",
        )

    def light_changes(self, frames: int) -> tuple[int, ...]:
        """Frames, from 1 to `frames - 1`, whose lights differ from those of the frame before."""
        lights = [dict(self.lights(float(frame))) for frame in range(frames)]
        return tuple(frame for frame in range(1, frames) if lights[frame] != lights[frame - 1])

    def select_take(self, name: str) -> Scene:
        """The scene as the take `name` shows it, without takes of its own.

        Raises SceneError if there is no such take; the message lists the takes.
        """
        take = next((take for take in self.takes if take.name == name), None)
        if take is None:
            names = ", ".join(take.name for take in self.takes) or "none"
            raise SceneError(f"scene '{self.name}' has no take '{name}'; available takes: {names}")
        return replace(
            self,
            camera=take.camera,
            vertex_animation=take.vertex_animation or self.vertex_animation,
            lights=take.lights,
            cuts=take.cuts,
            static=take.static,
            takes=(),
        )


@dataclass(frozen=True)
class Pose:
    """The camera, and the vertices of each mesh in the order of `Scene.meshes`."""

    camera: Camera
    vertices: tuple[Float[Array, "v 3"], ...]
    window: Window | None = None  # that the film shows of a larger, virtual frame

    @classmethod
    def at_time(cls, scene: Scene, time: float) -> Pose:
        """The pose of `scene` at `time`, in frames."""
        animated = scene.vertex_animation(time)
        vertices = tuple(animated.get(m.name, m.vertices) for m in scene.meshes)
        return cls(scene.camera(time), vertices, scene.window(time) if scene.window else None)

    def camera_axes(self) -> Float[Array, "3 3"]:
        """Rows: right, down and forward of the camera in world space, unit length, float64."""
        camera = self.camera
        forward = _normalize(np.subtract(camera.target, camera.origin, dtype=np.float64))
        right = _normalize(np.cross(forward, camera.up))
        return np.stack([right, np.cross(forward, right), forward])

    def tangent_per_pixel(self, width: int) -> float:
        """Tangent of the angle per pixel: tan(fov / 2) divided by half the whole frame's width."""
        frame_width = self.window.width if self.window else width
        return float(np.tan(np.radians(self.camera.fov) / 2) * 2 / frame_width)

    def film_centre(self, height: int, width: int) -> Float[Array, "2"]:
        """Where the view axis meets the film, in pixels; it may lie outside of a window."""
        frame = self.window or Window(height, width, 0, 0)
        return np.array([frame.width / 2 - frame.left, frame.height / 2 - frame.top])

    def ray_directions(
        self, film: Float[Array, "p 2"], height: int, width: int
    ) -> Float[Array, "p 3"]:
        """Unit rays through film positions in pixels (x right, y down, 0 at the corner)."""
        slopes = (film - self.film_centre(height, width)) * self.tangent_per_pixel(width)
        directions = np.column_stack([slopes, np.ones(len(film))]) @ self.camera_axes()
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))

    def project(
        self, points: Float[Array, "p 4"], height: int, width: int
    ) -> tuple[Float[Array, "p 2"], Float[Array, " p"]]:
        """Film positions in pixels (x right, y down, 0 at the corner) and depths along the axis.

        Points are homogeneous: (position, 1), or (direction, 0) for points at infinity.
        """
        local = (points[:, :3] - points[:, 3:] * np.asarray(self.camera.origin)) @ (
            self.camera_axes().T
        )
        depth = local[:, 2]
        slopes = local[:, :2] / np.maximum(depth, MIN_DEPTH)[:, None]
        return slopes / self.tangent_per_pixel(width) + self.film_centre(height, width), depth


def _normalize(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))

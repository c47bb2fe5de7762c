"""A scene as data: meshes, sky, and the takes that are filmed in it; knows no renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlbench.errors import RlbenchError

Vertices = Mapping[str, NDArray[np.float32]]  # v 3, by mesh name
Plugin = Mapping[str, Any]  # a Mitsuba plugin as a dictionary; "bitmap" textures may hold arrays


@dataclass(frozen=True)
class Mesh:
    """Triangles of one material. Merge what shares a material: every mesh costs time per launch."""

    name: str
    vertices: NDArray[np.float32]  # v 3, world space, metres, z up
    faces: NDArray[np.uint32]  # f 3, counter-clockwise from outside
    material: Plugin  # a BSDF, for example {"type": "diffuse", "reflectance": {...}}
    uv: NDArray[np.float32] | None = None  # v 2
    emission: Plugin | None = None  # an area emitter; many lights = one mesh with a bitmap atlas
    smooth: bool = False  # interpolate vertex normals?


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at one moment."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov: float = 60.0  # horizontal, degrees


@dataclass(frozen=True)
class Document:
    """A Mitsuba XML file, whose shapes, materials and lights only Mitsuba knows."""

    file: Path
    parameters: tuple[tuple[str, str], ...] = ()  # values for names that it has a <default> of


class SceneError(RlbenchError, ValueError):
    """A user's scene that cannot be rendered as asked."""


def _steady(time: float) -> Mapping[str, float]:
    """Lights as they were made."""
    return {}


@dataclass(frozen=True)
class Take:
    """A clip that shows a scene in another way than the scene does by itself.

    What a take does not say is as in the scene. `lights` gives, at a time, factors >= 0 on the
    emission of meshes by their names, and of `Scene.sky` by `sky0`, `sky1`, ...; a light that is
    not in it shines as it was made. From each frame of `cuts` on, another shot is seen, and history
    is worthless there: see `rlbench.render.mitsuba.gbuffer`.
    """

    name: str  # the clip is called <scene>-<name>; without a hyphen
    camera: Callable[[float], Camera]
    moving: Callable[[float], Vertices] | None = None
    lights: Callable[[float], Mapping[str, float]] = _steady
    cuts: tuple[int, ...] = ()
    static: bool = False  # neither camera nor meshes move; lights may change


@dataclass(frozen=True)
class Scene:
    """One animated scene. Time is in frames from 0; the same time always gives the same pose.

    By itself it is its own main clip; `takes` are further ones. `lights` and `cuts` are as in Take.
    """

    name: str
    title: str
    meshes: tuple[Mesh, ...]
    camera: Callable[[float], Camera]
    sky: tuple[Plugin, ...] = ()  # emitters without a surface: constant, sunsky, directional
    vertex_animation: Callable[[float], Vertices] = field(
        default=lambda time: {}
    )  # of the meshes that move
    lights: Callable[[float], Mapping[str, float]] = _steady
    cuts: tuple[int, ...] = ()  # frames at which another shot begins
    takes: tuple[Take, ...] = ()
    exposure: float = 1.0  # radiance is multiplied by this so that 1.0 is display white
    depth: int = 8  # longest light path, in edges
    static: bool = False  # neither camera nor meshes move
    document: Document | None = None  # replaces sky and all meshes; `meshes` are those that move
    origin: str = ""  # hash of what a user's scene is made of; replaces its fingerprint
    licence: str = "Apache-2.0"  # of the pixels

    def take(self, name: str) -> Scene:
        """The scene as its take of that name shows it; it has no takes itself.

        Raises SceneError, which lists the takes that there are.
        """
        found = next((take for take in self.takes if take.name == name), None)
        if found is None:
            have = ", ".join(take.name for take in self.takes) or "none"
            raise SceneError(f"scene '{self.name}' has no take '{name}'; it has: {have}")
        return replace(
            self,
            camera=found.camera,
            vertex_animation=found.moving or self.vertex_animation,
            lights=found.lights,
            cuts=found.cuts,
            static=found.static,
            takes=(),
        )

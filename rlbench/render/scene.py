"""A scene as data: meshes, sky, camera path and vertex animation; knows no renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


class SceneError(ValueError):
    """A user's scene that cannot be rendered as asked."""


@dataclass(frozen=True)
class Scene:
    """One animated scene. Time is in frames from 0; the same time always gives the same pose."""

    name: str
    title: str
    meshes: tuple[Mesh, ...]
    camera: Callable[[float], Camera]
    sky: tuple[Plugin, ...] = ()  # emitters without a surface: constant, sunsky, directional
    moving: Callable[[float], Mapping[str, NDArray[np.float32]]] = field(
        default=lambda time: {}
    )  # vertices, by mesh name, of the meshes that move
    exposure: float = 1.0  # radiance is multiplied by this so that 1.0 is display white
    depth: int = 8  # longest light path, in edges
    static: bool = False  # neither camera nor meshes move
    document: Document | None = None  # replaces sky and all meshes; `meshes` are those that move
    origin: str = ""  # hash of what a user's scene is made of; replaces its fingerprint
    licence: str = "Apache-2.0"  # of the pixels

"""Converts a scene to Mitsuba objects, and animates a loaded one: vertices, lights and camera.

Vertex normals are computed here, so that they are bit-identical in every run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.apps.render.mitsuba import mesh_texture, xml_scene
from rlbench.apps.render.scene import Mesh, MitsubaDict, Pose, Scene, Window
from rlbench.errors import RlbenchError

ALIGNMENT = 64  # bytes; Dr.Jit compiles another kernel for unaligned input
STRENGTH_PARAMETERS = (
    "radiance.value",
    "radiance.data",
    "irradiance.value",
    "intensity.value",
    "scale",  # of an environment map
    "sky_scale",
    "sun_scale",
)  # emitter parameters to which the emitted light is proportional
MIN_BITMAP_FACTOR = 1e-20  # a sampling table of zeros gives NaN


class LightError(RlbenchError, ValueError):
    """A light that Mitsuba would render wrong without an error, or that cannot be scaled."""


def instantiate(description: MitsubaDict) -> Any:
    """The Mitsuba object of a scene dict; numpy arrays may stand for bitmaps and 4x4 transforms."""
    import mitsuba as mi

    mesh_texture.register()
    return mi.load_dict(_to_mitsuba(description), optimize=False)


def load_scene(scene: Scene) -> Any:
    """A Mitsuba scene with one shape for each of `scene.meshes`, whose id is the mesh name."""
    import mitsuba as mi

    if scene.xml_file:
        return xml_scene.build_scene(scene.xml_file, merge=not scene.meshes)
    shapes = {m.name: _make_mesh(m) for m in scene.meshes}
    skies = {f"sky{i}": instantiate(sky) for i, sky in enumerate(scene.sky)}
    return mi.load_dict({"type": "scene", **shapes, **skies}, optimize=False)


def move_vertices(parameters: Any, vertices: Mapping[str, Array], meshes: Iterable[Mesh]) -> None:
    """Set new vertices of the meshes named in `vertices`. Nothing is loaded or compiled again.

    Smooth normals are computed here, because Mitsuba sums them in the order of its threads, so the
    last bits would differ from run to run.
    """
    moved = [mesh for mesh in meshes if mesh.name in vertices]
    for mesh in moved:
        _assign(parameters, f"{mesh.name}.vertex_positions", vertices[mesh.name])
    if moved:
        parameters.update()
    if smooth := [mesh for mesh in moved if mesh.smooth]:
        for mesh in smooth:
            normals = smooth_normals(vertices[mesh.name], mesh.faces)
            _assign(parameters, f"{mesh.name}.vertex_normals", normals)
        parameters.update()  # a second time, because new positions would overwrite new normals


def upload(kind: Any, values: Array) -> Any:
    """A Dr.Jit array of type `kind` with a copy of `values` in aligned memory."""
    dtype = np.dtype(np.uint32 if "UInt" in kind.__name__ or "Xu" in kind.__name__ else np.float32)
    flat = np.asarray(values, dtype).reshape(-1)
    buffer = np.empty(flat.nbytes + ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % ALIGNMENT
    aligned = buffer[start : start + flat.nbytes].view(dtype)
    aligned[:] = flat
    return kind(aligned)


def pinhole_vectors(pose: Pose, height: int, width: int) -> tuple[Any, Any, Any, Any]:
    """The pinhole as vectors: origin, ray through the upper left corner, steps per pixel x and y.

    They are opaque to the compiler, so a new camera needs no new kernel.
    """
    import drjit as dr
    import mitsuba as mi

    right, down, forward = pose.camera_axes()
    across, along = right * pose.tangent_per_pixel(width), down * pose.tangent_per_pixel(width)
    x, y = pose.film_centre(height, width)
    corner = forward - across * x - along * y

    def opaque(vector: Array) -> Any:
        return mi.Vector3f([dr.opaque(mi.Float, float(v)) for v in vector])

    origin = np.asarray(pose.camera.origin, np.float64)
    return opaque(origin), opaque(corner), opaque(across), opaque(along)


def make_sensor(pose: Pose, height: int, width: int) -> Any:
    """The same pinhole as a Mitsuba sensor, for the scalar variant."""
    import mitsuba as mi

    camera, window = pose.camera, pose.window or Window(height, width, 0, 0)
    film = {"type": "hdrfilm", "height": window.height, "width": window.width}
    crop = {"crop_offset_x": window.left, "crop_offset_y": window.top}
    film |= crop | {"crop_width": width, "crop_height": height, "rfilter": {"type": "box"}}
    pixels = {"pixel_format": "rgb", "component_format": "float32"}
    look_at = [[float(v) for v in p] for p in (camera.origin, camera.target, camera.up)]
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(camera.fov),
            "fov_axis": "x",
            "near_clip": 1e-4,
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f().look_at(*look_at),
            "film": {**film, **pixels},
            "sampler": {"type": "independent"},
        }
    )


def _make_mesh(mesh: Mesh) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["mesh_bsdf"] = instantiate(mesh.material)
    if mesh.emission is not None:
        _check_light(mesh.name, mesh.emission)
        properties["mesh_emitter"] = instantiate(mesh.emission)
    shape = mi.Mesh(
        mesh.name,
        len(mesh.vertices),
        len(mesh.faces),
        properties,
        has_vertex_normals=mesh.smooth or mesh.normals is not None,
        has_vertex_texcoords=mesh.uv is not None,
    )
    shape.set_id(mesh.name)
    parameters = mi.traverse(shape)
    _assign(parameters, "vertex_positions", mesh.vertices)
    _assign(parameters, "faces", mesh.faces)
    if mesh.uv is not None:
        _assign(parameters, "vertex_texcoords", mesh.uv)
    parameters.update()
    normals = mesh.normals
    if normals is None and mesh.smooth:
        normals = smooth_normals(mesh.vertices, mesh.faces)
    if normals is not None:
        _assign(parameters, "vertex_normals", _normalize(normals))
        parameters.update()
    for name, values in mesh.attributes.items():
        shape.add_attribute(name, values.shape[1], values.ravel().tolist())
    return shape


def _check_light(name: str, emission: MitsubaDict) -> None:
    """Raise LightError for a mesh attribute as radiance; next-event estimation takes it for 0."""
    radiance = emission.get("radiance")
    if isinstance(radiance, Mapping) and radiance.get("type") == "mesh_attribute":
        raise LightError(
            f"the radiance of mesh '{name}' is a mesh attribute, of which Mitsuba's path tracer "
            "loses a large part. Give each mesh one radiance, or a bitmap with a texel per light"
        )


def _assign(parameters: Any, name: str, values: Array) -> None:
    """Replace a buffer by a copy of `values`, converted to the variant's type."""
    parameters[name] = upload(type(parameters[name]), values)


def _to_mitsuba(value: Any, name: str = "") -> Any:
    """`value` with its arrays: `data` as tensor, `bitmap` as bitmap, matrices as transforms."""
    import mitsuba as mi

    if isinstance(value, Mapping):
        return {k: _to_mitsuba(v, k) for k, v in value.items()}
    if not isinstance(value, np.ndarray):
        return value
    if name == "data":
        return mi.TensorXf(np.ascontiguousarray(value, np.float32))
    if name == "bitmap":
        return mi.Bitmap(np.array(value, order="C"))
    if value.shape == (3, 3):
        return mi.ScalarTransform3f(value.astype(float))
    if value.shape == (4, 4):
        return mi.ScalarTransform4f(value.astype(float))
    return value.astype(float).tolist()


def smooth_normals(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "v 3"]:
    """Unit vertex normals: face normals weighted by the angle of each face at the vertex.

    Thuermer and Wuethrich 1998, Computing Vertex Normals from Polygonal Facets. The normal of a
    vertex without faces is z.
    """
    corners = vertices.astype(np.float64)[faces]  # f 3 3
    to_next, to_last = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    normal = _normalize(np.cross(to_next[:, 0], to_last[:, 0]))
    angle = np.arccos(np.clip((_normalize(to_next) * _normalize(to_last)).sum(-1), -1, 1))  # f 3
    weighted = (normal[:, None] * angle[..., None]).reshape(-1, 3)
    total = np.stack(
        [np.bincount(faces.ravel(), weighted[:, axis], len(vertices)) for axis in range(3)], 1
    )
    return np.where(np.any(total, 1, keepdims=True), _normalize(total), [0.0, 0.0, 1.0])


def _normalize(vectors: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Vectors scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


class EmitterScaler:
    """The emitters of a loaded scene, by the name of their mesh, or `sky0`, `sky1`, ..."""

    def __init__(self, parameters: Any) -> None:
        """Take the `parameters` from `mi.traverse`; all emitters are at full strength."""
        self._parameters = parameters
        self._full: dict[str, Any] = {}  # parameter values before the first change
        self._factors: Mapping[str, float] = {}

    def set_factors(self, factors: Mapping[str, float]) -> None:
        """Scale emitters by factors of their full strength; those not named get the factor 1.

        Kernels are not compiled again, except for the scales of sun and sky, which Mitsuba compiles
        in: one compilation per factor. Raises LightError for a factor that is negative or not
        finite, and for a name that no emitter has.
        """
        if factors == self._factors:
            return
        reset = dict.fromkeys(self._factors, 1.0)
        for name, factor in (reset | dict(factors)).items():
            if not 0 <= factor < np.inf:
                raise LightError(
                    f"light '{name}' is scaled by {factor}; factors must be finite and at least 0"
                )
            for key in self._strength_keys(name):
                self._scale(key, factor)
        self._parameters.update()
        self._factors = dict(factors)

    def _strength_keys(self, name: str) -> list[str]:
        """The parameters that hold the strength of an emitter."""
        candidates = [
            f"{name}.{middle}{parameter}"
            for middle in ("emitter.", "")
            for parameter in STRENGTH_PARAMETERS
        ]
        if keys := [key for key in candidates if key in self._parameters]:
            return keys
        names = ", ".join(self._emitter_names()) or "none"
        raise LightError(f"no light '{name}' whose strength can change; available: {names}")

    def _emitter_names(self) -> list[str]:
        """The names of the emitters that can be scaled."""
        names = {
            key.removesuffix(f".{parameter}").removesuffix(".emitter")
            for key in list(self._parameters.keys())
            for parameter in STRENGTH_PARAMETERS
            if key.endswith(parameter)
        }
        return sorted(name for name in names if ".bsdf" not in name)

    def _scale(self, key: str, factor: float) -> None:
        current = self._parameters[key]
        value = current if isinstance(current, float) else np.array(current)
        full = self._full.setdefault(key, value)
        self._parameters[key] = _scaled(current, full, factor)


def _scaled(current: Any, full: Any, factor: float) -> Any:
    """`full * factor` as a value of the type of `current`, opaque to Dr.Jit's compiler."""
    import drjit as dr
    import mitsuba as mi

    if isinstance(current, float):
        return full * factor
    if isinstance(current, mi.TensorXf):
        values = full * max(factor, MIN_BITMAP_FACTOR)
        return mi.TensorXf(upload(type(current.array), values), full.shape)
    channels = [dr.opaque(mi.Float, float(v)) for v in np.reshape(full * factor, -1)]
    return channels[0] if type(current) is mi.Float else type(current)(channels)

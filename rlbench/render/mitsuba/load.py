"""A scene as Mitsuba objects: numpy meshes, plugins, the camera's numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.errors import RlbenchError
from rlbench.render.mitsuba import xml_scene
from rlbench.render.pose import Pose
from rlbench.render.scene import Camera, Mesh, Plugin, Scene

ALIGNMENT = 64  # bytes; Dr.Jit compiles another kernel for input that is not aligned


class LightError(RlbenchError, ValueError):
    """A light that Mitsuba would leave dark without a word."""


def instantiate(plan: Plugin) -> Any:
    """The Mitsuba object that `plan` describes; arrays may stand for bitmaps and 4x4 transforms."""
    import mitsuba as mi

    return mi.load_dict(_native(plan), optimize=False)


def load_scene(scene: Scene) -> Any:
    """A Mitsuba scene with one mesh for each of `scene.meshes`, named as they are."""
    import mitsuba as mi

    if scene.xml_file:
        return xml_scene.build_scene(scene.xml_file, merge=not scene.meshes)
    parts = {m.name: _mesh(m) for m in scene.meshes}
    skies = {f"sky{i}": instantiate(sky) for i, sky in enumerate(scene.sky)}
    return mi.load_dict({"type": "scene", **parts, **skies}, optimize=False)


def move_vertices(parameters: Any, moved: Mapping[str, Array], meshes: Iterable[Mesh]) -> None:
    """Give the meshes named in `moved` new vertices. Nothing is loaded or compiled again.

    Smooth normals come from here, since Mitsuba adds them up in whatever order its threads run:
    the last bits would differ from run to run.
    """
    chosen = [mesh for mesh in meshes if mesh.name in moved]
    for mesh in chosen:
        _assign(parameters, f"{mesh.name}.vertex_positions", moved[mesh.name])
    if chosen:
        parameters.update()
    if smooth := [mesh for mesh in chosen if mesh.smooth]:
        for mesh in smooth:
            normals = smooth_normals(moved[mesh.name], mesh.faces)
            _assign(parameters, f"{mesh.name}.vertex_normals", normals)
        parameters.update()  # a second time, as new positions would overwrite new normals


def smooth_normals(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "v 3"]:
    """Unit normals of vertices: those of the faces around, weighted by the angle each has there.

    Thuermer and Wuethrich 1998, Computing Vertex Normals from Polygonal Facets. A vertex without
    faces has the normal z.
    """
    corners = vertices.astype(np.float64)[faces]  # f 3 3
    ahead, back = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    normal = _unit(np.cross(ahead[:, 0], back[:, 0]))
    angle = np.arccos(np.clip((_unit(ahead) * _unit(back)).sum(-1), -1, 1))  # f 3
    weighted = (normal[:, None] * angle[..., None]).reshape(-1, 3)
    total = np.stack(
        [np.bincount(faces.ravel(), weighted[:, axis], len(vertices)) for axis in range(3)], 1
    )
    return np.where(np.any(total, 1, keepdims=True), _unit(total), [0.0, 0.0, 1.0])


def upload(kind: Any, values: Array) -> Any:
    """A Dr.Jit array of `kind` with a copy of `values`, in memory that is always aligned alike."""
    dtype = np.dtype(np.uint32 if "UInt" in kind.__name__ or "Xu" in kind.__name__ else np.float32)
    flat = np.asarray(values, dtype).reshape(-1)
    room = np.empty(flat.nbytes + ALIGNMENT, np.uint8)
    start = -room.ctypes.data % ALIGNMENT
    aligned = room[start : start + flat.nbytes].view(dtype)
    aligned[:] = flat
    return kind(aligned)


def pinhole_vectors(pose: Pose, height: int, width: int) -> tuple[Any, Any, Any, Any]:
    """The pinhole as opaque vectors: origin, ray through the corner, and its steps x and y.

    Opaque, so that a new camera is new input to an old kernel rather than another kernel.
    """
    import drjit as dr
    import mitsuba as mi

    right, down, forward = pose.camera_axes()
    across, along = right * pose.tangent_per_pixel(width), down * pose.tangent_per_pixel(width)
    corner = forward - across * width / 2 - along * height / 2

    def opaque(vector: Array) -> Any:
        return mi.Vector3f([dr.opaque(mi.Float, float(v)) for v in vector])

    origin = np.asarray(pose.camera.origin, np.float64)
    return opaque(origin), opaque(corner), opaque(across), opaque(along)


def make_sensor(camera: Camera, height: int, width: int) -> Any:
    """The same pinhole as a Mitsuba sensor, for variants that have no wavefronts."""
    import mitsuba as mi

    film = {"type": "hdrfilm", "height": height, "width": width, "rfilter": {"type": "box"}}
    depths = {"pixel_format": "rgb", "component_format": "float32"}
    place = [[float(v) for v in p] for p in (camera.origin, camera.target, camera.up)]
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(camera.fov),
            "fov_axis": "x",
            "near_clip": 1e-4,
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f().look_at(*place),
            "film": {**film, **depths},
            "sampler": {"type": "independent"},
        }
    )


def _mesh(mesh: Mesh) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["mesh_bsdf"] = instantiate(mesh.material)
    if mesh.emission is not None:
        _check_light(mesh.name, mesh.emission)
        properties["mesh_emitter"] = instantiate(mesh.emission)
    made = mi.Mesh(
        mesh.name,
        len(mesh.vertices),
        len(mesh.faces),
        properties,
        has_vertex_normals=mesh.smooth,
        has_vertex_texcoords=mesh.uv is not None,
    )
    made.set_id(mesh.name)
    parameters = mi.traverse(made)
    _assign(parameters, "vertex_positions", mesh.vertices)
    _assign(parameters, "faces", mesh.faces)
    if mesh.uv is not None:
        _assign(parameters, "vertex_texcoords", mesh.uv)
    parameters.update()
    if mesh.smooth:
        _assign(parameters, "vertex_normals", smooth_normals(mesh.vertices, mesh.faces))
        parameters.update()
    return made


def _check_light(name: str, emission: Plugin) -> None:
    """Raise LightError for radiance by mesh attribute, which next-event estimation takes for 0."""
    radiance = emission.get("radiance")
    if isinstance(radiance, Mapping) and radiance.get("type") == "mesh_attribute":
        raise LightError(
            f"mesh '{name}' shines by a mesh attribute, of which Mitsuba's path tracer loses a "
            "good part; give one radiance a mesh, or a bitmap with a texel for each light"
        )


def _assign(parameters: Any, name: str, values: Array) -> None:
    """Replace a buffer by a copy of `values`, in the running variant's own type."""
    parameters[name] = upload(type(parameters[name]), values)


def _unit(vectors: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Vectors of length one, or zero where they were."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


def _native(value: Any, name: str = "") -> Any:
    """`value` with arrays as Mitsuba's own kinds: 4x4 transforms, and bitmaps named `data`."""
    import mitsuba as mi

    if isinstance(value, Mapping):
        return {k: _native(v, k) for k, v in value.items()}
    if not isinstance(value, np.ndarray):
        return value
    if name == "data":
        return mi.TensorXf(np.ascontiguousarray(value, np.float32))
    if value.shape == (4, 4):
        return mi.ScalarTransform4f(value.astype(float))
    return value.astype(float).tolist()

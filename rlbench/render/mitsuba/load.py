"""Converts a scene to Mitsuba objects: meshes, BSDFs, emitters and the camera."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from rlbench.errors import RlbenchError
from rlbench.render.mitsuba import xml_scene
from rlbench.render.mitsuba.normals import smooth_normals
from rlbench.render.pose import Pose
from rlbench.render.scene import Camera, Mesh, MitsubaDict, Scene

__all__ = [
    "LightError",
    "instantiate",
    "load_scene",
    "make_sensor",
    "move_vertices",
    "pinhole_vectors",
    "upload",
]

ALIGNMENT = 64  # bytes; Dr.Jit compiles another kernel for unaligned input


class LightError(RlbenchError, ValueError):
    """A light that Mitsuba would render wrong without an error, or that cannot be scaled."""


def instantiate(description: MitsubaDict) -> Any:
    """The Mitsuba object of a scene dict; numpy arrays may stand for bitmaps and 4x4 transforms."""
    import mitsuba as mi

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
    corner = forward - across * width / 2 - along * height / 2

    def opaque(vector: Array) -> Any:
        return mi.Vector3f([dr.opaque(mi.Float, float(v)) for v in vector])

    origin = np.asarray(pose.camera.origin, np.float64)
    return opaque(origin), opaque(corner), opaque(across), opaque(along)


def make_sensor(camera: Camera, height: int, width: int) -> Any:
    """The same pinhole as a Mitsuba sensor, for the scalar variant."""
    import mitsuba as mi

    film = {"type": "hdrfilm", "height": height, "width": width, "rfilter": {"type": "box"}}
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
        has_vertex_normals=mesh.smooth,
        has_vertex_texcoords=mesh.uv is not None,
    )
    shape.set_id(mesh.name)
    parameters = mi.traverse(shape)
    _assign(parameters, "vertex_positions", mesh.vertices)
    _assign(parameters, "faces", mesh.faces)
    if mesh.uv is not None:
        _assign(parameters, "vertex_texcoords", mesh.uv)
    parameters.update()
    if mesh.smooth:
        _assign(parameters, "vertex_normals", smooth_normals(mesh.vertices, mesh.faces))
        parameters.update()
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
    """`value` with arrays converted: those named `data` to tensors, 4x4 arrays to transforms."""
    import mitsuba as mi

    if isinstance(value, Mapping):
        return {k: _to_mitsuba(v, k) for k, v in value.items()}
    if not isinstance(value, np.ndarray):
        return value
    if name == "data":
        return mi.TensorXf(np.ascontiguousarray(value, np.float32))
    if value.shape == (4, 4):
        return mi.ScalarTransform4f(value.astype(float))
    return value.astype(float).tolist()

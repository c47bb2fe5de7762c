"""A glTF or GLB file as a Scene: its nodes become meshes in world space, lights and a camera.

The world is z up, as Blender's after an import: (x, y, z) of the file is (x, -z, y) here.
Primitives of one material are merged into one mesh, and instances are copies. Animations are not
played: nodes, skins and morph targets are as the file stores them. Tangents follow the texture
coordinates, as those of files do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.apps.render.gltf.document import DRACO, MESHOPT, Document
from rlbench.apps.render.gltf.materials import ALPHA, COLOR, READ, UV, Surface, read_material
from rlbench.apps.render.scene import Camera, Mesh, MitsubaDict, Scene, SceneError

Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
LIGHTS, INSTANCES = "KHR_lights_punctual", "EXT_mesh_gpu_instancing"
SUPPORTED = {*READ, DRACO, *MESHOPT, LIGHTS, INSTANCES, "KHR_mesh_quantization"}
GLTF_VERSION = 1  # raised whenever a file is rendered otherwise
MAX_DEPTH = 8  # longest light path, in edges


@dataclass(frozen=True)
class GltfScene:
    """What a file describes."""

    scene: Scene  # its camera is a placeholder
    camera_to_world: Float[Array, "4 4"] | None  # in Mitsuba's convention
    fov: float  # horizontal, degrees
    aspect: float  # width divided by height; 0 if the file does not say
    notes: list[str]


class _Node(NamedTuple):
    number: int
    node: Any
    to_world: Float[Array, "4 4"]


@dataclass
class _Batch:
    """Primitives that become one mesh."""

    surface: Surface
    is_mirrored: bool  # are the texture coordinates?
    count: int = 0  # vertices
    faces: list[Array] = field(default_factory=list)
    parts: dict[str, list[Array]] = field(default_factory=dict)  # vertices, normals, attributes

    def append(self, faces: Int[Array, "f 3"], part: Mapping[str, Array]) -> None:
        """Add triangles, and those vertices and attributes that they use."""
        used, corners = np.unique(faces, return_inverse=True)
        self.faces.append(corners.reshape(-1, 3) + self.count)
        self.count += len(used)
        for name, values in part.items():
            self.parts.setdefault(name, []).append(values[used].astype(np.float32))

    def mesh(self, name: str) -> Mesh:
        """All of it as one mesh."""
        joined = {part: np.concatenate(values) for part, values in self.parts.items()}
        bsdf = self.surface.bsdf
        return Mesh(
            name,
            joined.pop("vertices"),
            np.concatenate(self.faces).astype(np.uint32),
            _reverse_green(bsdf) if self.is_mirrored else bsdf,
            uv=joined.pop("uv", None),
            emission=self.surface.emission,
            normals=joined.pop("normals", None),
            attributes=joined,
        )


def read_gltf(file: Path, skip_missing: bool = False) -> GltfScene:
    """Read a .gltf or .glb file; see the module for its conventions.

    Raises SceneError for a file that is not valid, that needs an extension which is not read, that
    refers to missing files, or that has no mesh.
    """
    document = Document(file, skip_missing)
    needed = sorted(set(document.tree.extensionsRequired or []) - SUPPORTED)
    if needed:
        raise SceneError(
            f"{file} requires {', '.join(needed)}, which rlbench does not read. Export it without, "
            "or try --tracer cycles"
        )
    with document.errors():
        nodes = list(_walk(document))
        meshes = _meshes(document, nodes)
        sky = _lights(document, nodes)
        camera_to_world, fov, aspect = _camera(document, nodes)
    if not meshes:
        raise SceneError(f"{file} has no mesh, so there is nothing to render. Add one")
    if document.tree.animations:
        document.notes["animations are not played; --tracer cycles plays them"] += len(
            document.tree.animations
        )
    name = file.stem
    missing = tuple(sorted(set(document.missing_files)))
    scene = Scene(
        name,
        name,
        meshes,
        _no_camera,
        sky=sky,
        max_depth=MAX_DEPTH,
        static=True,
        source_hash=f"gltf {GLTF_VERSION} {document.digest} {missing}",
        missing_files=missing,
    )
    notes = [f"{what} ({count})" for what, count in document.notes.items()]
    return GltfScene(scene, camera_to_world, fov, aspect, notes)


def _no_camera(time: float) -> Camera:
    return Camera((0, 0, 0), (0, 1, 0))


def _walk(document: Document) -> Iterator[_Node]:
    """The nodes of the default scene with their transforms to world space."""
    tree = document.tree
    roots = list(range(len(tree.nodes)))
    if tree.scenes:
        roots = tree.scenes[tree.scene or 0].nodes or []
        if len(tree.scenes) > 1:
            document.notes["scenes beside the default one are left out"] += len(tree.scenes) - 1
    else:
        children = {child for node in tree.nodes for child in node.children or ()}
        roots = [index for index in roots if index not in children]
    due: list[tuple[int, Array]] = [(index, Z_UP) for index in reversed(roots)]
    seen: set[int] = set()
    while due:
        index, parent = due.pop()
        if index in seen:
            raise ValueError(f"node {index} has two parents, or its nodes form a cycle")
        seen.add(index)
        node = tree.nodes[index]
        to_world = parent @ _transform(node)
        yield _Node(index, node, to_world)
        due += [(child, to_world) for child in reversed(node.children or ())]


def _transform(node: Any) -> Float[Array, "4 4"]:
    """The transform of a node to its parent."""
    if node.matrix:
        return np.array(node.matrix, np.float64).reshape(4, 4).T
    return _compose(node.translation or (0, 0, 0), node.rotation or (0, 0, 0, 1), node.scale)


def _compose(translation: Any, rotation: Any, scale: Any) -> Float[Array, "4 4"]:
    """Translation times rotation (a quaternion x, y, z, w) times scale."""
    x, y, z, w = np.array(rotation, np.float64) / (np.linalg.norm(rotation) or 1.0)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= (1, 1, 1) if scale is None else scale
    matrix[:3, 3] = translation
    return matrix


class _Batches:
    """Collects primitives in world space, those of one material and kind in one mesh."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self._surfaces: dict[tuple[int | None, bool], Surface] = {}
        self._batches: dict[tuple[Any, ...], _Batch] = {}

    def add(
        self,
        material: int | None,
        attributes: Mapping[str, Array],
        faces: Int[Array, "f 3"],
        to_world: Array,
    ) -> None:
        """Add a primitive; `to_world` is one matrix, or one for each vertex."""
        part = _to_world(attributes, to_world)
        if "COLOR_0" in attributes:
            colors = attributes["COLOR_0"].astype(np.float32)
            part[COLOR] = colors[:, :3]
            part[ALPHA] = colors[:, 3:] if colors.shape[1] > 3 else np.ones_like(colors[:, :1])
        kind = material, COLOR in part
        if kind not in self._surfaces:
            self._surfaces[kind] = read_material(self.document, *kind)
        surface = self._surfaces[kind]
        part |= self._coordinates(attributes, surface)
        if to_world.ndim == 2 and np.linalg.det(to_world[:3, :3]) < 0:
            faces = faces[:, ::-1]
        is_mirrored = np.zeros(len(faces), bool)
        if surface.has_normal_map:
            is_mirrored = _are_mirrored(part["uv"][faces])
        for flipped in np.unique(is_mirrored):
            key = *kind, "normals" in part, bool(flipped)
            batch = self._batches.setdefault(key, _Batch(surface, bool(flipped)))
            batch.append(faces[is_mirrored == flipped], part)

    def meshes(self) -> tuple[Mesh, ...]:
        """One mesh for each batch, named by its number and material."""
        return tuple(
            batch.mesh(f"{number:03d}-{self._slug(material)}")
            for number, ((material, *_), batch) in enumerate(self._batches.items())
        )

    def _coordinates(self, attributes: Mapping[str, Array], surface: Surface) -> dict[str, Array]:
        """The texture coordinates that a material needs; zeros where a primitive lacks them."""
        part = {}
        for place, uv_set in enumerate(surface.uv_sets):
            found = attributes.get(f"TEXCOORD_{uv_set}")
            if found is None:
                self.document.notes["primitives lack texture coordinates of their material"] += 1
                found = np.zeros((len(attributes["POSITION"]), 2), np.float32)
            # an attribute is read by eval_attribute_3
            part[UV.format(uv_set) if place else "uv"] = np.pad(found, ((0, 0), (0, min(place, 1))))
        return part

    def _slug(self, material: int | None) -> str:
        """A name for the mesh of a material, without dots, which separate Mitsuba's parameters."""
        name = None if material is None else self.document.tree.materials[material].name
        return re.sub(r"[^\w-]+", "-", name or "material")[:40]


def _meshes(document: Document, nodes: list[_Node]) -> tuple[Mesh, ...]:
    """The meshes of all nodes, merged by material."""
    batches = _Batches(document)
    worlds = {node.number: node.to_world for node in nodes}
    read: dict[tuple[int, int], Any] = {}  # primitives, for the next instance
    for node in (node for node in nodes if node.node.mesh is not None):
        mesh = document.tree.meshes[node.node.mesh]
        for number, primitive in enumerate(mesh.primitives):
            place = node.node.mesh, number
            if place not in read:
                read[place] = document.primitive(primitive)
            if read[place] is None or not len(read[place][1]):
                continue
            attributes, faces = read[place]
            attributes = _morph(document, primitive, mesh.weights, attributes)
            for to_world in _placements(document, node, worlds, attributes):
                batches.add(primitive.material, attributes, faces, to_world)
    return batches.meshes()


def _morph(
    document: Document, primitive: Any, weights: list[float] | None, attributes: dict[str, Array]
) -> dict[str, Array]:
    """The attributes with their morph targets by the default weights."""
    for weight, target in zip(weights or (), primitive.targets or (), strict=False):
        named = target if isinstance(target, Mapping) else vars(target)
        for name in ("POSITION", "NORMAL"):
            if weight and isinstance(named.get(name), int) and name in attributes:
                moved = attributes[name] + weight * document.array(named[name])
                attributes = {**attributes, name: moved}
    return attributes


def _placements(
    document: Document,
    node: _Node,
    worlds: Mapping[int, Float[Array, "4 4"]],
    attributes: Mapping[str, Array],
) -> Iterator[Array]:
    """The transforms of a node's mesh: one for each instance, or one for each vertex of a skin."""
    extension = (node.node.extensions or {}).get(INSTANCES)
    if node.node.skin is not None and "JOINTS_0" in attributes:
        skin = document.tree.skins[node.node.skin]
        matrices = np.stack([worlds[joint] for joint in skin.joints])
        if skin.inverseBindMatrices is not None:
            binds = document.array(skin.inverseBindMatrices).reshape(-1, 4, 4)
            matrices = matrices @ binds.transpose(0, 2, 1)
        weights = attributes["WEIGHTS_0"].astype(np.float64)
        weights /= np.maximum(weights.sum(1, keepdims=True), 1e-9)
        yield np.einsum("vk,vkij->vij", weights, matrices[attributes["JOINTS_0"].astype(int)])
    elif extension:
        arrays = {k: document.array(v) for k, v in extension["attributes"].items() if k[0] != "_"}
        for index in range(len(next(iter(arrays.values())))):
            part = {name: values[index] for name, values in arrays.items()}
            yield node.to_world @ _compose(
                part.get("TRANSLATION", (0, 0, 0)),
                part.get("ROTATION", (0, 0, 0, 1)),
                part.get("SCALE"),
            )
    else:
        yield node.to_world


def _to_world(attributes: Mapping[str, Array], to_world: Array) -> dict[str, Array]:
    """Vertices and, where a primitive has any, normals in world space; normals are not unit."""
    linear = to_world[..., :3, :3]
    points = np.einsum("...ij,...j->...i", linear, attributes["POSITION"].astype(np.float64))
    part = {"vertices": points + to_world[..., :3, 3]}
    if "NORMAL" in attributes:
        inverse = np.linalg.pinv(linear)
        part["normals"] = np.einsum("...ji,...j->...i", inverse, attributes["NORMAL"])
    return part


def _are_mirrored(corners: Float[Array, "f 3 2"]) -> Array:
    """Which triangles show their texture mirrored, so that the bitangent of glTF is reversed."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] > 0)  # v points down


def _reverse_green(bsdf: MitsubaDict) -> MitsubaDict:
    """A BSDF with the second channel of its normal map inverted."""
    if bsdf["type"] == "normalmap":
        texture = bsdf["normalmap"]
        inner = texture.get("texture", texture)
        texels = inner["bitmap"].copy()
        texels[..., 1] = 255 - texels[..., 1]
        inner = {**inner, "bitmap": texels}
        texture = {**texture, "texture": inner} if "texture" in texture else inner
        return {**bsdf, "normalmap": texture}
    return {**bsdf, "bsdf": _reverse_green(bsdf["bsdf"])}


def _lights(document: Document, nodes: list[_Node]) -> tuple[MitsubaDict, ...]:
    """The lights of KHR_lights_punctual, in candela as radiant intensity and lux as irradiance."""
    listed = (document.tree.extensions or {}).get(LIGHTS, {}).get("lights", [])
    lights: list[MitsubaDict] = []
    for node in nodes:
        found = (node.node.extensions or {}).get(LIGHTS)
        if found is None:
            continue
        light = listed[found["light"]]
        color = [float(v) * light.get("intensity", 1.0) for v in light.get("color", (1, 1, 1))]
        rgb = {"type": "rgb", "value": color}
        position = node.to_world[:3, 3].tolist()
        forward = -node.to_world[:3, 2] / np.linalg.norm(node.to_world[:3, 2])
        if "range" in light:
            document.notes["ranges of lights are ignored"] += 1
        if light["type"] == "directional":
            lights.append({"type": "directional", "direction": forward.tolist(), "irradiance": rgb})
        elif light["type"] == "point":
            lights.append({"type": "point", "position": position, "intensity": rgb})
        else:
            cone = light.get("spot", {})
            up = node.to_world[:3, 1]
            lights.append(
                {
                    "type": "spot",
                    "to_world": _look_along(node.to_world[:3, 3], forward, up),
                    "intensity": rgb,
                    "cutoff_angle": float(np.degrees(cone.get("outerConeAngle", np.pi / 4))),
                    "beam_width": float(np.degrees(cone.get("innerConeAngle", 0.0))),
                }
            )
    return tuple(lights)


def _look_along(origin: Array, forward: Array, up: Array) -> Float[Array, "4 4"]:
    """A rigid matrix in Mitsuba's convention: +z is forward, +x points to the left."""
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], 1)
    return matrix


def _camera(
    document: Document, nodes: list[_Node]
) -> tuple[Float[Array, "4 4"] | None, float, float]:
    """The first perspective camera: camera-to-world, horizontal field of view, aspect ratio."""
    found = [node for node in nodes if node.node.camera is not None]
    lenses = [document.tree.cameras[node.node.camera].perspective for node in found]
    pinholes = [(node, lens) for node, lens in zip(found, lenses, strict=True) if lens]
    if len(found) > len(pinholes):
        document.notes["orthographic cameras are left out"] += len(found) - len(pinholes)
    if not pinholes:
        return None, 60.0, 0.0
    if len(pinholes) > 1:
        document.notes["cameras after the first are left out"] += len(pinholes) - 1
    node, lens = pinholes[0]
    aspect = lens.aspectRatio or 1.0
    fov = np.degrees(2 * np.arctan(np.tan(lens.yfov / 2) * aspect))
    forward = -node.to_world[:3, 2] / np.linalg.norm(node.to_world[:3, 2])
    matrix = _look_along(node.to_world[:3, 3], forward, node.to_world[:3, 1])
    return matrix, float(fov), lens.aspectRatio or 0.0

"""One small scene for both renderers: a Scene for Mitsuba, a glTF file and matrices for Blender.

A chequered floor and wall, three more sides, a box that slides, a pillar and a flat lamp; all
diffuse. The camera passes by. World is z up; glTF is y up, and Blender turns it back.
"""

from __future__ import annotations

import json

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene
from rlbench.apps.render.user import camera_path
from tests.apps.render import small_scenes

FRAMES, FPS, FOV, BOUNCES, LIGHT = 4, 24, 50.0, 6, (4.0, 3.5, 2.5)
PACE = np.array([0.12, -0.07, 0.0])  # metres a frame, of the box
Z_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # from our axes to glTF's


def quad(origin, u, v):
    """A rectangle: corners and faces, counter-clockwise seen from u x v."""
    origin, u, v = (np.array(x, float) for x in (origin, u, v))
    return np.array([origin, origin + u, origin + u + v, origin + v]), [[0, 1, 2], [0, 2, 3]]


def tiled(origin, u, v, colours, side):
    """Squares of a chequered rectangle, by colour: the linter needs texture edges."""
    u, v = np.array(u, float) / side, np.array(v, float) / side
    parts = [([], []) for _ in colours]
    for i, j in np.ndindex(side, side):
        corners, faces = quad(np.array(origin) + i * u + j * v, u, v)
        vertices, all_faces = parts[(i + j) % len(colours)]
        all_faces += (np.array(faces) + 4 * len(vertices)).tolist()
        vertices.append(corners)
    return [(np.concatenate(v), f, c) for (v, f), c in zip(parts, colours, strict=True)]


def box(low, high):
    mesh = small_scenes.box("box", low, high, {})
    return mesh.vertices, mesh.faces


def parts():
    """For each name: vertices, faces, albedo, radiance, and whether it moves."""
    floor = tiled((-3, -6, 0), (6, 0, 0), (0, 9, 0), [(0.7, 0.6, 0.3), (0.2, 0.35, 0.6)], 8)
    wall = tiled((-3, 3, 0), (6, 0, 0), (0, 0, 3), [(0.7, 0.25, 0.2), (0.75, 0.7, 0.6)], 6)
    shapes = {f"floor{i}": (*part, (0, 0, 0), False) for i, part in enumerate(floor)}
    shapes |= {f"wall{i}": (*part, (0, 0, 0), False) for i, part in enumerate(wall)}
    for name, x, colour in (("left", -3, (0.3, 0.6, 0.3)), ("right", 3, (0.6, 0.6, 0.2))):
        shapes[name] = (*quad((x, -6, 0), (0, 9, 0), (0, 0, 3)), colour, (0, 0, 0), False)
    shapes["ceiling"] = (*quad((-3, -6, 3), (6, 0, 0), (0, 9, 0)), (0.6,) * 3, (0, 0, 0), False)
    shapes["box"] = (*box((-0.6, -0.4, 0.0), (0.4, 0.6, 1.0)), (0.6, 0.3, 0.5), (0, 0, 0), True)
    shapes["pillar"] = (*box((1.2, 0.8, 0), (1.7, 1.3, 2.2)), (0.5, 0.5, 0.5), (0, 0, 0), False)
    lamp = box((-0.8, -0.8, 2.3), (0.8, 0.8, 2.4))  # closed, as Cycles' meshes shine to both sides
    shapes["lamp"] = (*lamp, (0, 0, 0), LIGHT, False)
    return shapes


def camera(time):
    return Camera(
        (0.25 * time - 0.5, -5.5 + 0.1 * time, 2.1), (0.2 * time - 0.3, 0.4, 0.9), fov=FOV
    )


def for_mitsuba():
    meshes, moving = [], {}
    for name, (vertices, faces, albedo, radiance, moves) in parts().items():
        points = vertices.astype(np.float32)
        light = {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}}
        twosided = {"type": "twosided", "bsdf": small_scenes.diffuse(*albedo)}
        emission = light if any(radiance) else None
        meshes.append(Mesh(name, points, np.array(faces, np.uint32), twosided, emission=emission))
        if moves:
            moving[name] = points
    return Scene(
        name="both",
        title="A scene for two tracers",
        meshes=tuple(meshes),
        camera=camera,
        vertex_animation=lambda time: {
            name: (points + max(time, 0.0) * PACE).astype(np.float32)
            for name, points in moving.items()
        },
        max_depth=BOUNCES + 2,
        exposure=1.0,
    )


def for_blender(folder):
    """Write both.gltf and path.json; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    data, views, accessors, meshes, nodes, materials = b"", [], [], [], [], []

    def buffer(array, kind, shape, bounds=False):
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        accessor = {"bufferView": len(views) - 1, "componentType": kind, "type": shape}
        accessor["count"] = array.size if shape == "SCALAR" else len(array)
        if bounds:
            low, high = array.min(0), array.max(0)
            accessor |= {"min": np.atleast_1d(low).tolist(), "max": np.atleast_1d(high).tolist()}
        accessors.append(accessor)
        return len(accessors) - 1

    for name, (vertices, faces, albedo, radiance, _) in parts().items():
        corners = (vertices[np.array(faces)].reshape(-1, 3) @ Z_UP.T).astype(np.float32)
        index = buffer(np.arange(len(corners), dtype=np.uint32), 5125, "SCALAR")
        position = buffer(corners, 5126, "VEC3", bounds=True)
        part = {"attributes": {"POSITION": position}, "indices": index, "material": len(meshes)}
        meshes.append({"primitives": [part]})
        nodes.append({"mesh": len(meshes) - 1, "name": name})
        materials.append(material(name, albedo, radiance))
    times = buffer((np.arange(FRAMES) / FPS).astype(np.float32), 5126, "SCALAR", bounds=True)
    path = np.arange(FRAMES)[:, None] * (PACE @ Z_UP.T)
    moved = buffer(path.astype(np.float32), 5126, "VEC3")
    target = {"node": list(parts()).index("box"), "path": "translation"}
    sampler = {"input": times, "output": moved, "interpolation": "LINEAR"}
    (folder / "both.bin").write_bytes(data)
    gltf = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_specular", "KHR_materials_emissive_strength"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"uri": "both.bin", "byteLength": len(data)}],
        "animations": [{"channels": [{"sampler": 0, "target": target}], "samplers": [sampler]}],
    }
    file, flight_path = folder / "both.gltf", folder / "path.json"
    file.write_text(json.dumps(gltf))
    matrices = [camera_path.matrix_from_camera(camera(time)).tolist() for time in range(FRAMES)]
    flight_path.write_text(json.dumps({"camera_to_world": matrices, "fov": FOV}))
    return file, flight_path


def material(name, albedo, radiance):
    """Diffuse alone: Blender's Principled without its specular layer."""
    strength = max(radiance)
    extensions = {"KHR_materials_specular": {"specularFactor": 0.0}}
    pbr = {"baseColorFactor": [*albedo, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}
    surface = {"name": name, "doubleSided": True, "pbrMetallicRoughness": pbr}
    surface["extensions"] = extensions
    if strength:
        surface["emissiveFactor"] = [value / strength for value in radiance]
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    return surface

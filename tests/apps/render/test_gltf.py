"""glTF files: geometry, materials, lights and cameras, against what the file was written with."""

from __future__ import annotations

import base64
import io
import json
import struct
from dataclasses import replace

import DracoPy
import meshopt
import numpy as np
import pytest
from PIL import Image

from rlbench.apps.render.gltf.document import Document
from rlbench.apps.render.gltf.read_scene import read_gltf
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Camera, SceneError
from rlbench.apps.render.user.clip import UserSceneOptions, ensure_user_clip
from rlbench.apps.render.user.sky import add_sky
from tests.apps.render.user.xml_room import PRESET

SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
UV = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float32)  # v points down
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
TYPES = {np.dtype("f4"): 5126, np.dtype("u2"): 5123, np.dtype("u1"): 5121, np.dtype("i1"): 5120}


class File:
    """A glTF document with a square that faces +z of the file, which tests change."""

    def __init__(self):
        self.blob = b""
        self.tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
                     "nodes": [{"mesh": 0}], "accessors": [], "bufferViews": [],
                     "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0}}]}  # fmt: skip
        places = {"POSITION": self.add(SQUARE), "TEXCOORD_0": self.add(UV)}
        self.primitive = {"attributes": places, "indices": self.add(FACES), "material": 0}
        self.tree["meshes"] = [{"primitives": [self.primitive]}]
        self.material = self.tree["materials"][0]

    def view(self, stored):
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(stored)}
        self.tree["bufferViews"].append(view)
        self.blob += stored
        return len(self.tree["bufferViews"]) - 1

    def add(self, values, **more):
        width = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        self.tree["accessors"].append(
            {"bufferView": self.view(values.tobytes()), "componentType": TYPES[values.dtype],
             "count": len(values), "type": width, **more}
        )  # fmt: skip
        return len(self.tree["accessors"]) - 1

    def texture(self, texels, **more):
        stream = io.BytesIO()
        Image.fromarray(np.array(texels, np.uint8)).save(stream, "png")
        uri = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
        self.tree.setdefault("images", []).append({"uri": uri})
        self.tree.setdefault("textures", []).append({"source": len(self.tree["images"]) - 1})
        return {"index": len(self.tree["textures"]) - 1, **more}

    def write(self, folder):
        file = folder / "square.glb"
        self.tree["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.tree).encode()
        chunks = ((text + b" " * (-len(text) % 4), b"JSON"),
                  (self.blob + b"\0" * (-len(self.blob) % 4), b"BIN\0"))  # fmt: skip
        body = b"".join(struct.pack("<I", len(c)) + kind + c for c, kind in chunks)
        file.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
        return file


def colours(file, folder, size=2, spp=256):
    """Radiance of a size x size image of the square under a white sky of 1."""
    scene = add_sky(read_gltf(file.write(folder)).scene, "1")
    camera = Camera((0, -1e3, 0), (0, 0, 0), fov=2 * np.degrees(np.arctan(1e-3)))
    scene = replace(scene, camera=lambda time: camera, max_depth=2)
    return open_tracer(scene, size, size).trace_mean(spp, "pilot")


def test_a_square_stands_upright_in_a_world_with_z_up(tmp_path):
    file = File()
    file.tree["nodes"][0] |= {"translation": [1, 2, 3], "scale": [2, -1, 1]}
    (mesh,) = read_gltf(file.write(tmp_path)).scene.meshes
    x, y, z = (SQUARE * (2, -1, 1) + (1, 2, 3)).T
    np.testing.assert_allclose(mesh.vertices, np.stack([x, -z, y], 1))
    one, two, three = mesh.vertices[mesh.faces[0]]
    assert np.cross(two - one, three - one)[1] < 0  # a mirrored node keeps its front


@pytest.mark.parametrize("kind", ["meshopt", "draco", "sparse", "strided"])
def test_vertices_are_the_same_however_they_are_stored(tmp_path, kind):
    file = File()
    place = file.primitive["attributes"]["POSITION"]
    accessor = file.tree["accessors"][place]
    if kind == "meshopt":
        packed = meshopt.encode_gltf_buffer(SQUARE, "ATTRIBUTES")
        stored = file.tree["bufferViews"][file.view(packed)]
        extension = {**stored, "byteStride": 12, "mode": "ATTRIBUTES", "count": 4}
        view = file.tree["bufferViews"][accessor["bufferView"]]
        view |= {"buffer": 0, "extensions": {"EXT_meshopt_compression": extension}}
    elif kind == "draco":
        packed = DracoPy.encode(SQUARE, FACES.reshape(-1, 3), preserve_order=True)
        draco = {"bufferView": file.view(packed), "attributes": {"POSITION": 0}}
        file.primitive["extensions"] = {"KHR_draco_mesh_compression": draco}
    elif kind == "sparse":
        del accessor["bufferView"]
        indices = file.view(np.arange(4, dtype=np.uint16).tobytes())
        values = file.view(SQUARE.tobytes())
        kinds = {"bufferView": indices, "componentType": 5123}
        accessor["sparse"] = {"count": 4, "values": {"bufferView": values}, "indices": kinds}
    else:
        rows = np.concatenate([SQUARE, UV], 1)
        accessor["bufferView"] = file.view(rows.tobytes())
        file.tree["bufferViews"][accessor["bufferView"]]["byteStride"] = 20
    (mesh,) = read_gltf(file.write(tmp_path)).scene.meshes
    # draco quantizes to 14 bits
    np.testing.assert_allclose(mesh.vertices[:, [0, 2]], SQUARE[:, :2], atol=2e-4)


def test_a_texture_is_upright_and_its_factor_and_transform_count(llvm, tmp_path):
    file = File()
    red_green = [[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]]
    texture = file.texture(red_green)
    file.tree["samplers"] = [{"magFilter": 9728}]
    file.tree["textures"][0]["sampler"] = 0
    pbr = file.material["pbrMetallicRoughness"]
    pbr |= {"baseColorTexture": texture, "baseColorFactor": [0.5, 0.5, 0.5, 1]}
    plain = colours(file, tmp_path)
    # principled without specular reflects about its base colour; see _energy
    np.testing.assert_allclose(plain / plain.max(), np.array(red_green) / 255, atol=0.1)
    assert 0.4 < plain.max() < 0.6
    move = {"KHR_texture_transform": {"offset": [0.5, 0]}}
    pbr["baseColorTexture"] = {**texture, "extensions": move}
    np.testing.assert_allclose(colours(file, tmp_path), plain[:, ::-1], atol=0.03)


def test_a_second_set_of_coordinates_and_vertex_colours_count(llvm, tmp_path):
    file = File()
    texture = file.texture([[(255, 0, 0), (255, 255, 255)]])
    file.material["pbrMetallicRoughness"]["baseColorTexture"] = {**texture, "texCoord": 1}
    file.material["normalTexture"] = file.texture([[(128, 128, 255)]])  # flat, by the first set
    attributes = file.primitive["attributes"]
    attributes["TEXCOORD_1"] = file.add(np.full((4, 2), 0.25, np.float32))
    attributes["COLOR_0"] = file.add(np.full((4, 3), 0.5, np.float32))
    red = colours(file, tmp_path).mean((0, 1))
    assert 0.35 < red[0] < 0.65
    assert red[1] < 0.2 * red[0]


@pytest.mark.parametrize("roughness", [0.2, 0.5, 0.8])
def test_a_white_furnace_is_white(llvm, tmp_path, roughness):
    file = File()
    file.material["pbrMetallicRoughness"]["roughnessFactor"] = roughness
    # from the front, where the Fresnel term is least; the average over directions is 0.98 to 1.02
    assert 0.9 < colours(file, tmp_path).mean() < 1.02


@pytest.mark.parametrize(("mode", "through"), [("MASK", 0.0), ("BLEND", 0.5), ("OPAQUE", 0.0)])
def test_alpha_is_a_threshold_or_an_opacity(llvm, tmp_path, mode, through):
    file = File()
    pbr = file.material["pbrMetallicRoughness"]
    pbr |= {"baseColorFactor": [0, 0, 0, 0.5], "roughnessFactor": 1}
    file.material["alphaMode"] = mode
    assert abs(colours(file, tmp_path).mean() - through) < 0.08  # the coat reflects a little


def test_lights_and_cameras_of_the_file_are_used(tmp_path):
    file = File()
    lamp = {"type": "point", "intensity": 7, "color": [1, 0.5, 0]}
    file.tree["extensions"] = {"KHR_lights_punctual": {"lights": [lamp]}}
    file.tree["nodes"] += [
        {"translation": [0, 3, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"translation": [0, 0, 5], "camera": 0},
    ]
    file.tree["scenes"][0]["nodes"] = [0, 1, 2]
    lens = {"yfov": 0.6, "znear": 0.1, "aspectRatio": 2}
    file.tree["cameras"] = [{"type": "perspective", "perspective": lens}]
    found = read_gltf(file.write(tmp_path))
    (light,) = found.scene.sky
    assert light["intensity"]["value"] == [7, 3.5, 0]
    np.testing.assert_allclose(light["position"], (0, 0, 3), atol=1e-12)
    np.testing.assert_allclose(found.camera_to_world[:3, 2:].T, [(0, 1, 0), (0, -5, 0)], atol=1e-12)
    assert found.fov == pytest.approx(2 * np.degrees(np.arctan(2 * np.tan(0.3))))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"extensionsRequired": ["KHR_texture_basisu"]}, "requires KHR_texture_basisu"),
        ({"asset": {"version": "1.0"}}, "is glTF 1.0"),
        ({"meshes": []}, "not a valid glTF"),
        ({"nodes": [{"children": [0]}]}, "nodes form a cycle"),
        ({"nodes": [{}]}, "has no mesh"),
        ({"images": [{"uri": "wood.png"}]}, "files that do not exist: wood.png"),
    ],
)
def test_a_broken_file_is_refused(tmp_path, change, match):
    file = File()
    file.tree |= change
    with pytest.raises(SceneError, match=match):
        read_gltf(file.write(tmp_path))


@pytest.mark.parametrize("content", [b"", b"glTF", b"{", b"[]", b"glTF\2\0\0\0\xff\0\0\0"])
def test_a_file_that_is_no_gltf_is_refused(tmp_path, content):
    (tmp_path / "a.glb").write_bytes(content)
    with pytest.raises(SceneError, match="not a valid glTF file"):
        Document(tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("camera", "sky", "match"),
    [("own", "1", "has no camera"), ("", "1", "has no camera"), ("wander", "", "has no light"),
     ("wander", "dawn", "neither a radiance"), ("wander", "-1", "finite radiance above 0")],
)  # fmt: skip
def test_without_camera_or_light_there_is_an_error(llvm, tmp_path, camera, sky, match):
    options = UserSceneOptions(File().write(tmp_path), camera, sky=sky, out=tmp_path / "clip")
    with pytest.raises(SceneError, match=match):
        ensure_user_clip(options, PRESET)
    assert not (tmp_path / "clip").exists()

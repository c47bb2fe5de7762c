"""Reads a glTF or GLB file: arrays, primitives and images, wherever and however they are stored.

pygltflib parses the document and the container. It keeps every property of glTF 2.0 and of its
extensions. trimesh, which is kept better, drops all texture coordinates but the first, samplers,
texture transforms, lights and cameras when it builds its meshes. Arrays, which pygltflib leaves as
bytes, are read here by numpy, images by Pillow, and compressed meshes by DracoPy and meshopt, where
these are installed.
"""

from __future__ import annotations

import base64
import hashlib
import io
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Int, UInt8
from numpy import ndarray as Array

from rlbench.apps.render.scene import SceneError

FORMATS = (".gltf", ".glb")
GREY = 188  # sRGB value of a reflectance of 0.5, for images whose files are missing
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
POINTS_AND_LINES, STRIP, FAN = (0, 1, 2, 3), 5, 6  # modes of a primitive
DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
BROKEN = (ValueError, LookupError, TypeError, AttributeError, OSError, struct.error)


class Document:
    """An opened file. `notes` counts, by sentences, what is rendered otherwise than it says."""

    def __init__(self, file: Path, skip_missing: bool = False) -> None:
        """Open a file; with `skip_missing`, images whose files are missing are grey.

        Raises SceneError for a file that is not glTF 2.0, and for one that refers to missing files.
        """
        self.file = file
        self.notes: Counter[str] = Counter()
        self.files: list[Path] = []  # beside this one
        self.missing_files: list[str] = []
        self._images: dict[int, UInt8[Array, "h w 4"]] = {}
        self._views: dict[int, bytes] = {}
        with self.errors():
            self.tree = _parse(file)
        if not str(self.tree.asset.version).startswith("2."):
            raise SceneError(
                f"{file} is glTF {self.tree.asset.version}; rlbench reads glTF 2.0. Convert it"
            )
        self._find_files(skip_missing)
        with self.errors():
            self._buffers = [self._read_buffer(index) for index in range(len(self.tree.buffers))]

    @property
    def digest(self) -> str:
        """Hash of the file and of all files that it refers to."""
        digest = hashlib.blake2b(digest_size=16)
        for file in (self.file, *self.files):
            digest.update(hashlib.blake2b(file.read_bytes()).digest())
        return digest.hexdigest()

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Raises what goes wrong while reading as SceneError."""
        try:
            yield
        except SceneError:
            raise
        except BROKEN as error:
            raise SceneError(
                f"{self.file} is not a valid glTF file ({type(error).__name__}: {error}). The glTF "
                "Validator of Khronos tells what is wrong with it"
            ) from error

    def array(self, index: int) -> Array:
        """The accessor `index`: [count width], float32 if it is normalized, else as it is stored.

        Sparse values replace those of the buffer, or zeros.
        """
        accessor = self.tree.accessors[index]
        dtype, width = DTYPES[accessor.componentType], WIDTHS[accessor.type]
        values = np.zeros((accessor.count, width), dtype)
        if accessor.bufferView is not None:
            place = accessor.bufferView, accessor.byteOffset or 0
            values = self._rows(*place, dtype, width, accessor.count)
        if sparse := accessor.sparse:
            places, new = (
                self._rows(part.bufferView, part.byteOffset or 0, kind, columns, sparse.count)
                for part, kind, columns in (
                    (sparse.indices, DTYPES[sparse.indices.componentType], 1),
                    (sparse.values, dtype, width),
                )
            )
            values = values.copy()
            values[places[:, 0]] = new
        return self._scaled(values, accessor)

    def primitive(self, primitive: Any) -> tuple[dict[str, Array], Int[Array, "f 3"]] | None:
        """The attributes of a primitive by name, and its triangles; None for points and lines."""
        if primitive.mode in POINTS_AND_LINES:
            self.notes["primitives of points or lines are left out"] += 1
            return None
        places = {k: v for k, v in vars(primitive.attributes).items() if isinstance(v, int)}
        compressed = (primitive.extensions or {}).get(DRACO)
        if compressed:
            attributes, corners = self._draco(compressed, places)
        else:
            attributes = {name: self.array(place) for name, place in places.items()}
            corners = np.arange(len(attributes["POSITION"]))
            if primitive.indices is not None:
                corners = self.array(primitive.indices)[:, 0].astype(np.int64)
        faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if primitive.mode == STRIP:
            faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
            faces[1::2] = faces[1::2, [1, 0, 2]]
        elif primitive.mode == FAN:
            faces = np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], 1)
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(attributes["POSITION"]):
            raise ValueError("an index of a primitive exceeds its vertices")
        return attributes, faces

    def image(self, index: int) -> UInt8[Array, "h w 4"]:
        """The image `index` as 8 bit RGBA, as it is stored; grey if its file is missing."""
        if index not in self._images:
            self._images[index] = self._read_image(index)
        return self._images[index]

    def _rows(self, view: int, offset: int, dtype: str, width: int, count: int) -> Array:
        size = np.dtype(dtype).itemsize
        stride = self.tree.bufferViews[view].byteStride or size * width
        return np.ndarray((count, width), dtype, self._view(view), offset, (stride, size))

    def _scaled(self, values: Array, accessor: Any) -> Array:
        """Normalized integers as numbers of [-1, 1]."""
        if not accessor.normalized or values.dtype.kind == "f":
            return values
        return np.maximum(values / np.float32(np.iinfo(values.dtype).max), np.float32(-1))

    def _view(self, index: int) -> bytes:
        """The bytes of a buffer view, decompressed."""
        if index not in self._views:
            view = self.tree.bufferViews[index]
            packed = next(filter(None, map((view.extensions or {}).get, MESHOPT)), None)
            if packed:
                start = packed.get("byteOffset", 0)
                stored = self._buffers[packed["buffer"]][start : start + packed["byteLength"]]
                self._views[index] = (
                    _decoder("meshopt")
                    .decode_gltf_buffer(
                        stored,
                        packed["count"],
                        packed["byteStride"],
                        packed["mode"],
                        packed.get("filter", "NONE"),
                    )
                    .tobytes()
                )
            else:
                start = view.byteOffset or 0
                self._views[index] = self._buffers[view.buffer][start : start + view.byteLength]
        return self._views[index]

    def _draco(
        self, compressed: dict[str, Any], places: dict[str, int]
    ) -> tuple[dict[str, Array], Int[Array, " corners"]]:
        mesh = _decoder("DracoPy").decode(self._view(compressed["bufferView"]))
        attributes = {}
        for name, identity in compressed["attributes"].items():
            accessor = self.tree.accessors[places[name]]
            values = np.asarray(mesh.get_attribute_by_unique_id(identity)["data"])
            values = values.reshape(-1, WIDTHS[accessor.type])
            attributes[name] = self._scaled(values.astype(DTYPES[accessor.componentType]), accessor)
        return attributes, np.asarray(mesh.faces, np.int64).ravel()

    def _find_files(self, skip_missing: bool) -> None:
        """List the files beside this one. Raises SceneError for those that do not exist."""
        lost = []
        for part in (*self.tree.buffers, *self.tree.images):
            if not part.uri or part.uri.startswith("data:"):
                continue
            path = self._path(part.uri)
            if path.is_file():
                self.files.append(path)
            elif skip_missing and part in self.tree.images:
                self.missing_files.append(part.uri)
                self.notes["textures made grey, because files are missing"] += 1
            else:
                lost.append(part.uri)
        if lost:
            raise SceneError(
                f"{self.file} refers to files that do not exist: {', '.join(sorted(set(lost)))}. "
                "--skip-missing makes such textures grey"
            )

    def _path(self, uri: str) -> Path:
        return self.file.parent / unquote(uri)

    def _read_uri(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self._path(uri).read_bytes()

    def _read_buffer(self, index: int) -> bytes:
        """The bytes of a buffer; none for one that only stands in for compressed data."""
        buffer = self.tree.buffers[index]
        stored = self._read_uri(buffer.uri) if buffer.uri else self.tree.binary_blob()
        if buffer.uri and len(stored) < buffer.byteLength:
            raise ValueError(f"buffer {index} has {len(stored)} of {buffer.byteLength} bytes")
        return stored or b""

    def _read_image(self, index: int) -> UInt8[Array, "h w 4"]:
        from PIL import Image, UnidentifiedImageError

        image = self.tree.images[index]
        if image.uri in self.missing_files:
            return np.full((1, 1, 4), (GREY, GREY, GREY, 255), np.uint8)
        stored = self._read_uri(image.uri) if image.uri else self._view(image.bufferView)
        try:
            with Image.open(io.BytesIO(stored)) as picture:
                if not picture.mode.startswith("I;16"):
                    return np.asarray(picture.convert("RGBA"))
                high = (np.asarray(picture) >> 8).astype(np.uint8)  # Pillow would clip it
                return np.asarray(Image.fromarray(high).convert("RGBA"))
        except UnidentifiedImageError as error:
            name = image.uri[:60] if image.uri else image.name or f"image {index}"
            raise SceneError(
                f"{self.file}: {name} ({image.mimeType or 'unknown format'}) cannot be decoded. "
                "Convert its textures to PNG or JPEG; for KTX2, gltf-transform does so"
            ) from error


def _parse(file: Path) -> Any:
    """The document of a file. A GLB begins with its magic number, whatever the file is called."""
    from pygltflib import GLTF2

    content = file.read_bytes()
    if content[:4] == b"glTF":
        (length,) = struct.unpack("<I", content[8:12])
        if length > len(content):
            raise ValueError(f"it has {len(content)} of {length} bytes")
        tree = GLTF2.load_from_bytes(content)
    else:
        tree = GLTF2.gltf_from_json(content.decode("utf-8-sig"))
    if tree is None:
        raise ValueError("it has no JSON chunk")
    return tree


def _decoder(name: str) -> Any:
    """A library that decodes compressed meshes."""
    try:
        return import_module(name)
    except ImportError as error:
        raise SceneError(
            f"the meshes of this file are compressed, and {name}, which decodes them, is not "
            "installed: pip install -c constraints.txt -e '.[gltf]' in a clone of rlbench"
        ) from error

"""Noisebase's test sequences: a zip a frame, with samples, geometry and camera of each.

A folder a sequence: `frame0000.zip`, `frame0001.zip`, ... (Balint et al. 2023, Neural Partitioning
Pyramids for Denoising Monte Carlo Renderings; noisebase, docs/formats/sample_test_v1.md). What is
stored for every sample becomes the view by taking it of the first: one hit a pixel, as a renderer
has it, not the mean of many. Depth and motion are worked out from world positions and cameras.

Where the first sample's normal is zero nothing was hit: depth is +inf, and motion is that of a
point infinitely far. Differs from Noisebase's loader: rows are not cut off (it drops 28 at the top
and at the bottom), depth is the distance along the view axis, and albedo is clipped to [0, 1]. The
first frame has no motion there either; here it has where the frame before it lies beside it.
"""

from __future__ import annotations

import re
import zipfile
from collections import defaultdict
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rlbench.clips.importers import limits
from rlbench.clips.importers.sequence import (
    ImportedFrame,
    ImportedSequence,
    Pixels,
    SourceError,
    clip_name,
    consecutive,
)
from rlbench.clips.importers.zarr_v2 import array, opened, shapes

LAYOUT = "SEQUENCE/frame0000.zip, SEQUENCE/frame0001.zip"
FILE = re.compile(r"frame(\d{4,})\.zip")
FPS = 30.0  # as Noisebase's own loader tells its metrics
FARTHEST = 5e3  # pixels: longer motion is cut, as Noisebase's loader does
ASTRAY = 1.0  # pixels: median distance of a hit from its pixel's centre, at most
IMAGES = {  # leading axes of what is read; h, w and mostly samples follow
    "color": 4,
    "reference": 3,
    "position": 3,
    "motion": 3,
    "normal": 3,
    "diffuse": 3,
}
SINGLE = ("reference",)  # not stored for each sample


class Camera(NamedTuple):
    """A frame's camera, in world space."""

    position: Pixels  # 3
    forward: Pixels  # 3, unit
    matrix: Pixels  # 4 4, world to clip space, for row vectors: [p, 1] @ matrix


def sequences(source: Path, wanted: tuple[int, int] | None) -> list[ImportedSequence]:
    """The sequences of a folder, or of the folders in it. Raises SourceError."""
    found: dict[Path, dict[int, Path]] = defaultdict(dict)
    for path in limits.files(source):
        if match := FILE.fullmatch(path.name):
            found[path.parent][int(match[1])] = path
    return [_sequence(folder.resolve().name, paths, wanted) for folder, paths in found.items()]


def _sequence(
    name: str, paths: Mapping[int, Path], wanted: tuple[int, int] | None
) -> ImportedSequence:
    name = clip_name(name)
    numbers = consecutive(f"clip '{name}'", paths, wanted)
    sizes = {number: _size(paths[number]) for number in numbers}
    first = sizes[numbers[0]]
    for number, size in sizes.items():
        limits.same_size(paths[number], size[:2], first[:2])
    known = numbers[0] - 1 in paths  # the camera before the first frame
    return ImportedSequence(
        name=name,
        sampler="unknown, imported from Noisebase",
        height=first[0],
        width=first[1],
        numbers=numbers,
        counts=tuple(size[2] for size in sizes.values()),
        reference_spp=(0,) * len(numbers),
        buffers=("albedo", "normal", "depth", "motion"),
        lacks=("halves",) if known else ("halves", "first motion"),
        files=tuple(paths[number] for number in (*((numbers[0] - 1,) * known), *numbers)),
        read=partial(_read, paths, first[:2]),
        fps=FPS,
    )


def _size(path: Path) -> tuple[int, int, int]:
    """Height, width and samples of a frame whose arrays agree. Raises SourceError."""
    with opened(path) as archive:
        if "reference/.zarray" not in archive.NameToInfo:
            raise SourceError(f"{path} has no 'reference', so nothing can be scored on it")
        found = shapes(archive, list(IMAGES))
    if len(found["color"]) != 4:
        raise SourceError(f"{path}: color is of shape {found['color']}, expected 4, h, w, samples")
    _, h, w, s = found["color"]
    limits.check_size(path, h, w)
    for key, leading in IMAGES.items():
        expected = (leading, h, w) if key in SINGLE else (leading, h, w, s)
        if found[key] != expected:
            raise SourceError(f"{path}: {key} is of shape {found[key]}, expected {expected}")
    return h, w, s


def _read(
    paths: Mapping[int, Path], size: tuple[int, int], number: int, samples: int
) -> ImportedFrame:
    with opened(paths[number]) as archive:
        camera = _camera(archive)
        position, moved, normal, albedo = (
            np.moveaxis(array(archive, key, last=1)[..., 0], 0, -1).astype(np.float64)
            for key in ("position", "motion", "normal", "diffuse")
        )
        pool = _radiance(array(archive, "color", samples), array(archive, "exposure"))
        reference = np.moveaxis(array(archive, "reference"), 0, -1)
    hit = np.any(normal, axis=-1, keepdims=True)
    here = _project(camera, position, size)
    _proven(paths[number], here, hit, size)
    motion = np.zeros_like(here)
    if number - 1 in paths:
        with opened(paths[number - 1]) as archive:
            before = _camera(archive)
        motion = np.where(
            hit, _project(before, position + moved, size) - here, _far(camera, before, size)
        ).clip(-FARTHEST, FARTHEST)
    depth = (position - camera.position) @ camera.forward
    gbuffer = {
        "albedo": albedo.clip(0, 1),
        "normal": normal,
        "depth": np.where(hit, depth[..., None], np.inf),
        "motion": motion,
    }
    return ImportedFrame(gbuffer, pool, reference, reference)


def _radiance(rgbe: Pixels, exposure: Pixels) -> Pixels:
    """Radiance [s h w 3] of colours [4 h w s] whose last is an exponent in 256 steps of log e."""
    low, high = exposure.tolist()
    scale = np.exp((rgbe[3].astype(np.float32) + 1) / 256 * (high - low) + low)
    return np.moveaxis(rgbe[:3] / np.float32(255) * scale, (0, 3), (3, 0))


def _camera(archive: zipfile.ZipFile) -> Camera:
    target, position, matrix = (
        array(archive, key).astype(np.float64)
        for key in ("camera_target", "camera_position", "view_proj_mat")
    )
    if (target.shape, position.shape, matrix.shape) != ((3,), (3,), (4, 4)):
        raise SourceError(
            f"{archive.filename}: the camera's position, target or matrix is misshapen"
        )
    forward = target - position
    return Camera(position, forward / np.linalg.norm(forward), matrix)


def _project(camera: Camera, points: Pixels, size: tuple[int, int], weight: float = 1.0) -> Pixels:
    """Where points [h w 3] are in the image, pixels, x right and y down; directions of weight 0."""
    clip = points @ camera.matrix[:3] + weight * camera.matrix[3]
    ahead = clip[..., 3:] != 0
    flat = np.where(ahead, clip[..., :2] / np.where(ahead, clip[..., 3:], 1), 0)
    return np.asarray((flat * (1, -1) + 1) / 2 * (size[1], size[0]))


def _far(camera: Camera, before: Camera, size: tuple[int, int]) -> Pixels:
    """Motion [h w 2] of what is infinitely far, pixels."""
    flat = _centres(size) / (size[1], size[0]) * (2, -2) + (-1, 1)
    clip = np.concatenate((flat, np.ones((*size, 2))), axis=-1)
    points = clip @ np.linalg.inv(camera.matrix)
    # a far plane at infinity has weight 0, so nothing is divided by it
    rays = points[..., :3] - points[..., 3:] * camera.position
    return _project(before, rays, size, weight=0) - _project(camera, rays, size, weight=0)


def _centres(size: tuple[int, int]) -> Pixels:
    """Pixel centres [h w 2], x right and y down."""
    return np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), -1) + 0.5


def _proven(path: Path, here: Pixels, hit: Pixels, size: tuple[int, int]) -> None:
    """Raise SourceError where hits do not project onto their own pixels: motion would be wrong."""
    away = np.linalg.norm(here - _centres(size), axis=-1)[hit[..., 0]]
    if away.size and not np.median(away) <= ASTRAY:
        raise SourceError(
            f"{path}: world positions project {np.median(away):.1f} pixels away from their own "
            f"pixels (median); is it a crop of a larger image, or its matrix not for row vectors?"
        )

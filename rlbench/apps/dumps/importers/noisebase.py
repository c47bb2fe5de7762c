"""Noisebase's test sequences: one zip per frame, with samples, geometry and camera.

A sequence is a folder of `frame0000.zip`, `frame0001.zip`, ... (Balint et al. 2023, Neural
Partitioning Pyramids for Denoising Monte Carlo Renderings; noisebase,
docs/formats/sample_test_v1.md). The G-buffer holds the features of the first sample: one hit per
pixel, as in a renderer, not the mean of many. Depth and motion are computed from world positions
and cameras.

Where the first sample's normal is zero, no surface was hit: depth is +inf, and motion is that of an
infinitely distant point. Differs from Noisebase's loader: rows are not cropped (it drops 28 at the
top and at the bottom), depth is the distance along the view axis, and albedo is clipped to [0, 1].
The first frame has no motion there; here it has motion if the file of the frame before it exists.
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

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.sequence import (
    ImportedFrame,
    ImportedSequence,
    clip_name,
    select_frames,
)
from rlbench.apps.dumps.importers.zarr_v2 import open_archive, read_array, read_shapes
from rlbench.clips.image_files import Pixels, check_size
from rlbench.errors import SourceError

LAYOUT = "SEQUENCE/frame0000.zip, SEQUENCE/frame0001.zip"
FILE = re.compile(r"frame(\d{4,})\.zip")
FPS = 30.0  # that Noisebase's loader passes to its metrics
MAX_MOTION = 5e3  # pixels: longer motion is clipped, as in Noisebase's loader
MAX_PROJECTION_ERROR = 1.0  # pixels: median distance of a hit from its pixel's centre
LEADING_AXIS = {  # length of the first axis of each array; h, w and mostly samples follow
    "color": 4,
    "reference": 3,
    "position": 3,
    "motion": 3,
    "normal": 3,
    "diffuse": 3,
}
FIXED_SHAPES = {
    "exposure": (2,),
    "camera_position": (3,),
    "camera_target": (3,),
    "view_proj_mat": (4, 4),
}
PER_PIXEL = ("reference",)  # arrays without an axis of samples


class Camera(NamedTuple):
    """The camera of a frame, in world space."""

    position: Pixels  # 3
    forward: Pixels  # 3, unit
    matrix: Pixels  # 4 4, world to clip space, for row vectors: [p, 1] @ matrix


def find_sequences(source: Path, frames: tuple[int, int] | None) -> list[ImportedSequence]:
    """The sequences in a folder and its subfolders. Raises SourceError."""
    folders: dict[Path, dict[int, Path]] = defaultdict(dict)
    for path in limits.list_files(source):
        if match := FILE.fullmatch(path.name):
            folders[path.parent][int(match[1])] = path
    return [_sequence(folder.resolve().name, paths, frames) for folder, paths in folders.items()]


def _sequence(
    name: str, paths: Mapping[int, Path], frames: tuple[int, int] | None
) -> ImportedSequence:
    name = clip_name(name)
    numbers = select_frames(f"clip '{name}'", paths, frames)
    sizes = {number: _size(paths[number]) for number in numbers}
    first = sizes[numbers[0]]
    for number, size in sizes.items():
        limits.check_same_size(paths[number], size[:2], first[:2])
    has_previous = numbers[0] - 1 in paths  # so the camera before the first frame is known
    return ImportedSequence(
        name=name,
        sampler="unknown, imported from Noisebase",
        height=first[0],
        width=first[1],
        numbers=numbers,
        counts=tuple(size[2] for size in sizes.values()),
        reference_spp=(0,) * len(numbers),
        buffers=("albedo", "normal", "depth", "motion"),
        limitations=("halves",) if has_previous else ("halves", "first motion"),
        files=tuple(paths[number] for number in (*((numbers[0] - 1,) * has_previous), *numbers)),
        read=partial(_read, paths, first[:2]),
        fps=FPS,
    )


def _size(path: Path) -> tuple[int, int, int]:
    """Height, width and samples of a frame whose arrays agree. Raises SourceError."""
    with open_archive(path) as archive:
        if "reference/.zarray" not in archive.NameToInfo:
            raise SourceError(f"{path} has no 'reference', so nothing can be scored on it")
        shapes = read_shapes(archive, [*LEADING_AXIS, *FIXED_SHAPES])
    if len(shapes["color"]) != 4:
        raise SourceError(f"{path}: color is of shape {shapes['color']}, expected 4, h, w, samples")
    _, h, w, s = shapes["color"]
    check_size(path, h, w)
    for key, leading in LEADING_AXIS.items():
        expected = (leading, h, w) if key in PER_PIXEL else (leading, h, w, s)
        if shapes[key] != expected:
            raise SourceError(f"{path}: {key} is of shape {shapes[key]}, expected {expected}")
    for key, expected_shape in FIXED_SHAPES.items():
        if shapes[key] != expected_shape:
            raise SourceError(f"{path}: {key} is of shape {shapes[key]}, expected {expected_shape}")
    return h, w, s


def _read(
    paths: Mapping[int, Path], size: tuple[int, int], number: int, samples: int
) -> ImportedFrame:
    with open_archive(paths[number]) as archive:
        camera = _camera(archive)
        position, displacement, normal, albedo = (
            np.moveaxis(read_array(archive, key, last=1)[..., 0], 0, -1).astype(np.float64)
            for key in ("position", "motion", "normal", "diffuse")
        )
        colours = read_array(archive, "color", samples)
        pool = _decode_rgbe(colours, read_array(archive, "exposure"))
        reference = np.moveaxis(read_array(archive, "reference"), 0, -1)
    hit = np.any(normal, axis=-1, keepdims=True)
    projected = _project(camera, position, size)
    _check_projection(paths[number], projected, hit, size)
    motion = np.zeros_like(projected)
    if number - 1 in paths:
        with open_archive(paths[number - 1]) as archive:
            previous = _camera(archive)
        motion = np.where(
            hit,
            _project(previous, position + displacement, size) - projected,
            _motion_at_infinity(camera, previous, size),
        ).clip(-MAX_MOTION, MAX_MOTION)
    depth = (position - camera.position) @ camera.forward
    gbuffer = {
        "albedo": albedo.clip(0, 1),
        "normal": normal,
        "depth": np.where(hit, depth[..., None], np.inf),
        "motion": motion,
    }
    files = dict.fromkeys(("radiance", "reference", *gbuffer), paths[number])
    return ImportedFrame(gbuffer, pool, reference, reference, files=files)


def _decode_rgbe(rgbe: Pixels, exposure: Pixels) -> Pixels:
    """Radiance [s h w 3] of RGBE colours [4 h w s].

    The fourth channel is the exponent of e, in 256 steps over the range `exposure`.
    """
    low, high = exposure.tolist()
    scale = np.exp((rgbe[3].astype(np.float32) + 1) / 256 * (high - low) + low)
    return np.moveaxis(rgbe[:3] / np.float32(255) * scale, (0, 3), (3, 0))


def _camera(archive: zipfile.ZipFile) -> Camera:
    target, position, matrix = (
        read_array(archive, key).astype(np.float64)
        for key in ("camera_target", "camera_position", "view_proj_mat")
    )
    forward = target - position
    return Camera(position, forward / np.linalg.norm(forward), matrix)


def _project(camera: Camera, points: Pixels, size: tuple[int, int], weight: float = 1.0) -> Pixels:
    """Image positions of points [h w 3], pixels, x right and y down; weight 0 is for directions."""
    clip = points @ camera.matrix[:3] + weight * camera.matrix[3]
    finite = clip[..., 3:] != 0
    ndc = np.where(finite, clip[..., :2] / np.where(finite, clip[..., 3:], 1), 0)
    return np.asarray((ndc * (1, -1) + 1) / 2 * (size[1], size[0]))


def _motion_at_infinity(camera: Camera, previous: Camera, size: tuple[int, int]) -> Pixels:
    """Motion [h w 2] of infinitely distant points, pixels."""
    ndc = _pixel_centres(size) / (size[1], size[0]) * (2, -2) + (-1, 1)
    clip = np.concatenate((ndc, np.ones((*size, 2))), axis=-1)
    points = clip @ np.linalg.inv(camera.matrix)
    # a far plane at infinity has weight 0, so nothing is divided by it
    rays = points[..., :3] - points[..., 3:] * camera.position
    return _project(previous, rays, size, weight=0) - _project(camera, rays, size, weight=0)


def _pixel_centres(size: tuple[int, int]) -> Pixels:
    """Pixel centres [h w 2], x right and y down."""
    return np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), -1) + 0.5


def _check_projection(path: Path, projected: Pixels, hit: Pixels, size: tuple[int, int]) -> None:
    """Raise SourceError where hits do not project onto their own pixels: motion would be wrong."""
    errors = np.linalg.norm(projected - _pixel_centres(size), axis=-1)[hit[..., 0]]
    if errors.size and not np.median(errors) <= MAX_PROJECTION_ERROR:
        raise SourceError(
            f"{path}: world positions project {np.median(errors):.1f} pixels away from their own "
            "pixels (median). The image may be a crop of a larger one, or view_proj_mat may not "
            "be for row vectors; import uncropped frames as Noisebase wrote them"
        )

"""Tiny sources in each format, written by code that shares nothing with the readers."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rlbench.apps.dumps.importers import formats, writer
from rlbench.clips.stored import StoredClip, open_clip
from tests.apps.dumps.exr_files import write_image

H, W = 12, 16  # at least the window of SSIM
ROWS, COLUMNS = np.mgrid[:H, :W]


def import_clip(source: Path, format_: str, out: Path, **options: object) -> StoredClip:
    """Import the only clip of a source and open it."""
    (sequence,) = formats.find_sequences(source, format_, options.get("frames"))
    header = writer.clip_header(sequence, options.get("samples"))
    writer.write_clip(sequence, header, out / sequence.name)
    return open_clip(out / sequence.name, frozenset(sequence.buffers), max_samples=64)


def stored(clip: StoredClip, index: int, buffer: str) -> np.ndarray:
    """A buffer of the G-buffer, [h w c]."""
    return clip.frame(index).gbuffer.buffers[buffer][0].permute(1, 2, 0).numpy()


def pool(clip: StoredClip, index: int) -> np.ndarray:
    """The samples of a frame, sorted by their value at the first pixel, [s h w 3]."""
    samples = clip.frame(index).pool.radiance[0].permute(0, 2, 3, 1).numpy()
    return samples[np.argsort(samples[:, 0, 0, 0])]


# OIDN


def radiance(frame: int, seed: int) -> np.ndarray:
    """Multiples of 1/8 up to 20, so exact in half precision."""
    return ((ROWS + COLUMNS + 2 * frame + seed)[..., None] + [0, 0.5, 8]).astype(np.float32) / 8


def write_oidn(folder: Path, frames: int = 3, seeds: int = 2, halves: bool = False) -> Path:
    """walk_0000_seed0_0001spp.hdr.exr and so on, with albedo and normal, and a reference."""
    for frame in range(frames):
        for seed in range(seeds):
            stem = f"walk_{frame:04d}_seed{seed}_0001spp"
            write_image(folder / f"{stem}.hdr.exr", radiance(frame, seed))
            albedo = np.full((H, W, 3), (0.25, 0.5, 1.5), np.float32) / (1 + seed)
            write_image(folder / f"{stem}.alb.exr", albedo)
            normal = np.full((H, W, 3), (0, -0.6, 0.8), np.float32) * 2
            normal[0] = 0
            write_image(folder / f"{stem}.nrm.exr", normal, "XYZ")
        for seed in range(2 if halves else 1):
            stem = f"walk_{frame:04d}_seed{8 + seed}_1024spp"
            write_image(folder / f"{stem}.hdr.exr", radiance(frame, 8 + seed) + np.float32(1 / 3))
    return folder


# Noisebase

ZOOM = 1.25  # of the projection across the image; ZOOM * W / H up and down
FAR = 4.0  # the wall's distance along the view axis


def camera(frame: int, step: float, yaw: float) -> tuple[np.ndarray, ...]:
    """Position, right, up, forward of a camera that steps along x and turns about y."""
    angle = frame * yaw
    forward = np.array([np.sin(angle), 0, np.cos(angle)])
    up = np.array([0.0, 1, 0])
    return np.array([step * frame, 0, 0]), np.cross(forward, up), up, forward


def plane() -> tuple[np.ndarray, np.ndarray]:
    """Pixel centres on the image plane one unit ahead: rightwards, upwards."""
    x = ((COLUMNS + 0.5) / W * 2 - 1) / ZOOM
    y = (1 - (ROWS + 0.5) / H * 2) / (ZOOM * W / H)
    return x, y


def noisebase_arrays(
    frame: int, samples: int = 6, step: float = 0.1, yaw: float = 0.0
) -> dict[str, np.ndarray]:
    """A wall at distance FAR that faces the camera.

    Row 0 is sky; the lower half moves down by 0.05.
    """
    position, right, up, forward = camera(frame, step, yaw)
    x, y = plane()
    wall = position + FAR * (x[..., None] * right + y[..., None] * up + forward)
    displacement = np.zeros((H, W, 3))
    displacement[H // 2 :, :, 1] = 0.05
    normal = np.broadcast_to(-forward, (H, W, 3)).copy()
    normal[0], wall[0] = 0, 0
    rotation = np.eye(4)
    rotation[:3, :3] = right, up, forward
    shift = np.eye(4)
    shift[:3, 3] = -position
    projection = np.zeros((4, 4))
    projection[[0, 1, 2, 2, 3], [0, 1, 2, 3, 2]] = ZOOM, ZOOM * W / H, 1, -0.1, 1

    def sampled(image: np.ndarray, dtype: type) -> np.ndarray:
        first = np.moveaxis(image, -1, 0).astype(dtype)
        return np.stack([first, *[first + dtype(1)] * (samples - 1)], -1)  # only the first counts

    colour = np.empty((4, H, W, samples), np.uint8)
    colour[:3] = (COLUMNS + ROWS + 10 * frame)[None, ..., None] + np.arange(samples)
    colour[3] = 255
    colour[3, :, ::2] = 127
    return {
        "color": colour,
        "exposure": np.log([0.125, 2.0]).astype(np.float32),
        "reference": np.full((3, H, W), 1 / 3 + frame, np.float32),
        "position": sampled(wall, np.float32),
        "motion": sampled(displacement, np.float32),
        "normal": sampled(normal, np.float16),
        "diffuse": sampled(np.full((H, W, 3), (0.25, 0.5, 1.5)), np.float16),
        "camera_position": position.astype(np.float32),
        "camera_target": (position + 3 * forward).astype(np.float32),
        "camera_up": up.astype(np.float32),
        "view_proj_mat": (projection @ rotation @ shift).T.astype(np.float32),
        "proj_mat": projection.astype(np.float32),
        "crop_offset": np.zeros(2, np.int32),
    }


def zarr_zip(path: Path, arrays: dict[str, np.ndarray], **change: object) -> None:
    """Format zarr 2 by hand: chunks of four along the last axis of images, LZ4.

    `change` replaces metadata of "color".
    """
    numcodecs = pytest.importorskip("numcodecs", reason="the extra noisebase is not installed")
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(".zgroup", '{"zarr_format": 2}')
        for key, values in arrays.items():
            chunks = [*values.shape[:-1], min(4, values.shape[-1])] if values.ndim > 3 else None
            chunks = chunks or list(values.shape)
            metadata = {
                "zarr_format": 2,
                "shape": values.shape,
                "chunks": chunks,
                "dtype": values.dtype.str,
                "compressor": {"id": "lz4", "acceleration": 1},
                "fill_value": 0,
                "filters": None,
                "order": "C",
            }
            metadata |= change if key == "color" else {}
            archive.writestr(f"{key}/.zarray", json.dumps(metadata))
            for number, start in enumerate(range(0, values.shape[-1], chunks[-1])):
                part = np.zeros(chunks, values.dtype)
                elements = values[..., start : start + chunks[-1]]
                part[..., : elements.shape[-1]] = elements
                name = ".".join([*"0" * (values.ndim - 1), str(number)])
                archive.writestr(f"{key}/{name}", bytes(numcodecs.LZ4().encode(part)))


def write_noisebase(folder: Path, frames: int = 3, samples: int = 6, **motion: float) -> Path:
    """frame0000.zip and so on, in a folder `corridor`."""
    for frame in range(frames):
        arrays = noisebase_arrays(frame, samples, **motion)
        zarr_zip(folder / "corridor" / f"frame{frame:04d}.zip", arrays)
    return folder


# RL_PATH_TRACING

DRIFT = (1.5, -0.75)  # Blender's vector: previous minus current position, x right, y up


def png16(path: Path, image: np.ndarray) -> None:
    """A PNG of three 16-bit colours."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    h, w, _ = image.shape
    raw = b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)
    head = struct.pack(">IIBBBBB", w, h, 16, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)


def display(frame: int, slot: int) -> np.ndarray:
    """Bytes of a PNG, from dark to white."""
    value = ROWS * W + COLUMNS + 7 * slot + frame
    return np.stack([value, 255 - value, value // 2], -1).clip(0, 255).astype(np.uint8)


def display_bytes(light: np.ndarray) -> np.ndarray:
    """Bytes of a PNG from linear light (sRGB, IEC 61966-2-1), clipped and rounded."""
    light = light.clip(0, 1)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * curve).astype(np.uint8)


def grid() -> torch.Tensor:
    """Previous positions of the pixels for grid_sample, as the authors' script writes them."""
    x = (DRIFT[0] * 2 + COLUMNS * 2 - W + 1) / W
    y = (-DRIFT[1] * 2 + ROWS * 2 - H + 1) / H
    return torch.from_numpy(np.stack((x, y), -1)).float()[None]


def write_rl_path_tracing(
    folder: Path, frames: int = 3, samples: int = 8, corr: str = "corr"
) -> Path:
    """One scene, `suntemple`, whose first frame is 1 and has no motion file."""
    scene = folder / "suntemple"
    (scene / "motions").mkdir(parents=True)
    for frame in range(1, frames + 1):
        for slot in range(samples):
            Image.fromarray(display(frame, slot)).save(scene / f"{slot:02d}-{frame:04d}.png")
        Image.fromarray(display(frame, 3)).save(scene / f"gd{frame:04d}.png")
        for step, name in enumerate(("Normal", "Albedo", "Depth")):
            level = np.full((H, W, 3), 257 * (20 * step + frame), np.uint16)
            png16(scene / f"add{f'Denoising {name}' * 2}{frame:04d}.png", level)
        if frame > 1:
            torch.save(grid(), scene / "motions" / f"{frame:04d}{corr}.pt")
    return folder


WRITERS = {
    "oidn": write_oidn,
    "noisebase": write_noisebase,
    "rl-path-tracing": write_rl_path_tracing,
}

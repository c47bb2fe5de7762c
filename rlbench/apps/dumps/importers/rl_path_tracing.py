"""The files of RL_PATH_TRACING: 8-bit PNGs from Blender, and motion as torch tensors.

A folder holds one scene: `SS-FFFF.png` is sample SS of frame FFFF, `gdFFFF.png` its reference with
1000 spp, `addDenoising AlbedoDenoising AlbedoFFFF.png` its albedo, files with `Denoising Normal`
and `Denoising Depth` its normals and depth, and `motions/FFFFcorr.pt` or `motions/FFFF.pt` its
motion (Scardigli, Cavigelli, Muller 2023, github.com/AJSVB/RL_PATH_TRACING). As there, only the
upper left 720 x 720 pixels are kept.

The files do not meet all requirements of a clip, and the header lists these limitations:
- The PNGs went through Blender's display transform and were clipped. The sRGB curve is inverted, so
  that metrics, which apply it again, see the values of the PNGs: 1.0 is display white, and means of
  samples are means of displayed light.
- Normals have lost their negative part, depth all values above 1, and albedo may have been
  transformed. They are value / 255. Differs from the authors: not stretched to [0, 1] frame by
  frame, because the values of a static surface would change from frame to frame.
- Samples have the seeds 0 to 7 in every frame, and one of them is the seed of the reference.
"""

from __future__ import annotations

import re
import zipfile
from collections import defaultdict
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.sequence import (
    ImportedFrame,
    ImportedSequence,
    clip_name,
    select_frames,
)
from rlbench.clips.image_files import Pixels, png_size, read_png
from rlbench.errors import SourceError
from rlbench.ops.color import decode_srgb

LAYOUT = "SCENE/00-0001.png, SCENE/gd0001.png, SCENE/motions/0001corr.pt"
MAX_SIDE = 720  # pixels: larger images are cropped to their upper left corner
REFERENCE_SPP = 1000
FILE = re.compile(
    r"(?P<slot>\d\d)-(?P<sample>\d{4,})\.png|gd(?P<reference>\d{4,})\.png"
    r"|add(?P<pass>Denoising (?:Albedo|Normal|Depth))(?P=pass)(?P<gbuffer>\d{4,})\.png"
    r"|(?P<motion>\d{4,})(?:corr)?\.pt"
)
PASSES = {f"Denoising {name.capitalize()}": name for name in ("albedo", "normal", "depth")}
Frames = Mapping[int, Mapping[str, Path]]  # by number and by image: s0 to s7, reference, ...


def find_sequences(source: Path, selection: tuple[int, int] | None) -> list[ImportedSequence]:
    """The sequences in a folder and its subfolders. Raises SourceError."""
    scenes: dict[Path, dict[int, dict[str, Path]]] = defaultdict(lambda: defaultdict(dict))
    for path in limits.list_files(source):
        if match := FILE.fullmatch(path.name):
            parts = {key: value for key, value in match.groupdict().items() if value}
            folder = path.parent
            if "motion" in parts:
                if folder.name != "motions":
                    continue
                folder = folder.parent
            image = f"s{int(parts.pop('slot'))}" if "slot" in parts else next(iter(parts))
            image = PASSES[parts.pop("pass")] if "pass" in parts else image
            images = scenes[folder][int(next(iter(parts.values())))]
            if image not in images or path.name.endswith("corr.pt"):  # as in the authors' loader
                images[image] = path
    return [
        _sequence(folder.resolve().name, frames, selection) for folder, frames in scenes.items()
    ]


def _sequence(name: str, source: Frames, selection: tuple[int, int] | None) -> ImportedSequence:
    name = clip_name(name)
    rendered = [number for number, images in source.items() if set(images) - {"motion"}]
    if not rendered:
        raise SourceError(f"'{name}' has motion but no images; expected {LAYOUT}")
    numbers = select_frames(f"clip '{name}'", rendered, selection)
    frames = {number: source[number] for number in numbers}
    _check(name, frames)
    buffers = _buffers(name, frames)
    full_size = png_size(frames[numbers[0]]["s0"])
    limitations = ["halves", "independence", "linear"]
    limitations += [buffer for buffer in PASSES.values() if buffer in buffers]
    if "motion" in buffers and "motion" not in frames[numbers[0]]:
        limitations.append("first motion")
    return ImportedSequence(
        name=name,
        sampler="Cycles, imported from 8-bit PNG",
        height=min(full_size[0], MAX_SIDE),
        width=min(full_size[1], MAX_SIDE),
        numbers=numbers,
        counts=tuple(_count_samples(images) for images in frames.values()),
        reference_spp=(REFERENCE_SPP,) * len(numbers),
        buffers=buffers,
        limitations=tuple(limitations),
        files=tuple(path for images in frames.values() for path in images.values()),
        read=partial(_read, frames, buffers, full_size),
        exposure=1.0,  # the PNGs are what was displayed
    )


def _buffers(name: str, frames: Frames) -> tuple[str, ...]:
    """The buffers that every frame has; the first frame needs no motion. Raises SourceError."""
    numbers = sorted(frames)
    existing = set.union(*(set(images) for images in frames.values()))
    buffers = tuple(b for b in ("albedo", "normal", "depth", "motion") if b in existing)
    if not buffers:
        raise SourceError(
            f"clip '{name}' has neither {', '.join(PASSES)} nor motion; it needs at least one"
        )
    for buffer in buffers:
        with_buffer = [number for number, images in frames.items() if buffer in images]
        first = numbers[buffer == "motion" and len(numbers) > 1]
        select_frames(f"clip '{name}', {buffer}", with_buffer, (first, numbers[-1] + 1))
    return buffers


def _check(name: str, frames: Frames) -> None:
    """Raise SourceError where a frame has no sample or no reference."""
    for number, images in frames.items():
        if not _count_samples(images):
            raise SourceError(f"clip '{name}', frame {number} has no sample 00-{number:04d}.png")
        if "reference" not in images:
            raise SourceError(
                f"clip '{name}', frame {number} has no reference gd{number:04d}.png, "
                "so nothing can be scored on it"
            )


def _count_samples(images: Mapping[str, Path]) -> int:
    """Number of samples before the first that is missing."""
    return next(slot for slot in range(len(images) + 1) if f"s{slot}" not in images)


def _read(
    frames: Frames, buffers: tuple[str, ...], full_size: tuple[int, int], number: int, samples: int
) -> ImportedFrame:
    images = frames[number]
    h, w = min(full_size[0], MAX_SIDE), min(full_size[1], MAX_SIDE)
    gbuffer: dict[str, Pixels] = {}
    for buffer in buffers:
        if buffer == "motion":
            path = images.get("motion")
            gbuffer[buffer] = np.zeros((h, w, 2)) if path is None else _read_motion(path, h, w)
        else:
            value = _read_cropped(images[buffer], full_size) / 255
            gbuffer[buffer] = value[..., :1] if buffer == "depth" else value
    pool = np.stack([_read_radiance(images[f"s{slot}"], full_size) for slot in range(samples)])
    reference = _read_radiance(images["reference"], full_size)
    return ImportedFrame(gbuffer, pool, reference, reference)


def _read_radiance(path: Path, full_size: tuple[int, int]) -> Pixels:
    """Linear radiance of a PNG, [h w 3] in [0, 1]: the sRGB curve is inverted."""
    display = torch.from_numpy(_read_cropped(path, full_size) / 255)
    return decode_srgb(display).numpy()


def _read_cropped(path: Path, full_size: tuple[int, int]) -> NDArray[np.uint8]:
    """The pixels of a PNG inside the crop."""
    pixels = read_png(path)
    if pixels.shape[:2] == (720, 1280) and full_size == (1080, 1920):  # as in the authors' loader
        resized = Image.fromarray(pixels).resize((1920, 1080), Image.Resampling.BILINEAR)
        pixels = np.asarray(resized)
    limits.check_same_size(path, pixels.shape[:2], full_size)
    return pixels[:MAX_SIDE, :MAX_SIDE]


def _read_motion(path: Path, h: int, w: int) -> Pixels:
    """Motion [h w 2] to the previous position, pixels, x right and y down, from a tensor file.

    The file holds coordinates for `grid_sample` with align_corners=False, (2 x + 1) / w - 1, at the
    previous position x. It is a pickle in a zip: only tensors are unpickled, and only after the
    sizes in the zip were checked. Raises SourceError.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > 16 * h * w + 2**16:
            raise SourceError(f"{path} unpacks to {size} bytes, {8 * h * w} are expected")
        grid = torch.load(path, map_location="cpu", weights_only=True)
    except SourceError:
        raise
    except Exception as error:  # a broken file can make the unpickler raise anything
        raise SourceError(
            f"{path} is not a tensor of float32 that torch.save wrote, and nothing else is read: "
            f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
        ) from error
    if not isinstance(grid, torch.Tensor) or grid.dtype != torch.float32:
        raise SourceError(f"{path} holds a {type(grid).__name__}, expected a tensor of float32")
    if grid.shape != (1, h, w, 2) or grid.layout != torch.strided:
        raise SourceError(
            f"{path} is of shape {tuple(grid.shape)}, expected {(1, h, w, 2)}: "
            "all frames of a clip have one size"
        )
    x, y = np.moveaxis(grid[0].double().numpy(), -1, 0)
    columns, rows = np.meshgrid(np.arange(w), np.arange(h))
    return np.stack(((x + 1) * w / 2 - 0.5 - columns, (y + 1) * h / 2 - 0.5 - rows), -1)

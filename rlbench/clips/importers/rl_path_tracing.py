"""The paper authors' own files: 8-bit PNGs from Blender, and motion as torch tensors.

A folder a scene: `SS-FFFF.png` is sample SS of frame FFFF, `gdFFFF.png` its reference of 1000 spp,
`addDenoising AlbedoDenoising AlbedoFFFF.png` and the like for `Denoising Normal` and `Denoising
Depth`, and `motions/FFFFcorr.pt` or `motions/FFFF.pt` (Scardigli, Cavigelli, Muller 2023,
github.com/AJSVB/RL_PATH_TRACING). As there, all but the upper left 720 x 720 pixels are cut off.

The files do not hold what a clip should, and the header says so:
- The PNGs went through Blender's display transform and were clipped. sRGB's curve is taken off, so
  that metrics, which put it on again, see the PNGs' values: 1.0 is display white, and means of
  samples are means of displayed light.
- Normals have lost their negative part, depth all beyond 1, albedo may have been transformed.
  They are value / 255. Differs from the authors: not stretched to [0, 1] frame by frame, which
  would make a still surface's values jump from frame to frame.
- Samples have the seeds 0 to 7 in every frame, and one of them is the reference's.
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

from rlbench.clips.importers import limits
from rlbench.clips.importers.image_files import png_size, read_png
from rlbench.clips.importers.sequence import (
    ImportedFrame,
    ImportedSequence,
    Pixels,
    SourceError,
    clip_name,
    consecutive,
)

LAYOUT = "SCENE/00-0001.png, SCENE/gd0001.png, SCENE/motions/0001corr.pt"
SIDE = 720  # pixels that are kept of each side, from the upper left
REFERENCE_SPP = 1000
FILE = re.compile(
    r"(?P<slot>\d\d)-(?P<sample>\d{4,})\.png|gd(?P<reference>\d{4,})\.png"
    r"|add(?P<pass>Denoising (?:Albedo|Normal|Depth))(?P=pass)(?P<view>\d{4,})\.png"
    r"|(?P<motion>\d{4,})(?:corr)?\.pt"
)
PASSES = {f"Denoising {name.capitalize()}": name for name in ("albedo", "normal", "depth")}
Frames = Mapping[int, Mapping[str, Path]]  # by number and by what it is: s0 to s7, reference, ...


def sequences(source: Path, wanted: tuple[int, int] | None) -> list[ImportedSequence]:
    """The clips of a scene's folder, or of one that holds such. Raises SourceError."""
    found: dict[Path, dict[int, dict[str, Path]]] = defaultdict(lambda: defaultdict(dict))
    for path in limits.files(source):
        if match := FILE.fullmatch(path.name):
            told = {key: value for key, value in match.groupdict().items() if value}
            folder = path.parent
            if "motion" in told:
                if folder.name != "motions":
                    continue
                folder = folder.parent
            kind = f"s{int(told.pop('slot'))}" if "slot" in told else next(iter(told))
            kind = PASSES[told.pop("pass")] if "pass" in told else kind
            images = found[folder][int(next(iter(told.values())))]
            if kind not in images or path.name.endswith("corr.pt"):  # as the authors' loader
                images[kind] = path
    return [_sequence(folder.resolve().name, frames, wanted) for folder, frames in found.items()]


def _sequence(name: str, found: Frames, wanted: tuple[int, int] | None) -> ImportedSequence:
    name = clip_name(name)
    traced = [number for number, images in found.items() if set(images) - {"motion"}]
    if not traced:
        raise SourceError(f"'{name}' has motion and no images; expected {LAYOUT}")
    numbers = consecutive(f"clip '{name}'", traced, wanted)
    frames = {number: found[number] for number in numbers}
    _check(name, frames)
    there = set.union(*(set(images) for images in frames.values()))
    buffers = tuple(b for b in ("albedo", "normal", "depth", "motion") if b in there)
    if not buffers:
        raise SourceError(
            f"clip '{name}' has neither {', '.join(PASSES)} nor motion; one is needed"
        )
    for buffer in buffers:
        having = [number for number, images in frames.items() if buffer in images]
        first = numbers[buffer == "motion" and len(numbers) > 1]  # the first needs no motion
        consecutive(f"clip '{name}', {buffer}", having, (first, numbers[-1] + 1))
    whole = png_size(frames[numbers[0]]["s0"])
    lacks = ["halves", "independence", "linear", *(b for b in PASSES.values() if b in buffers)]
    if "motion" in buffers and "motion" not in frames[numbers[0]]:
        lacks.append("first motion")
    return ImportedSequence(
        name=name,
        sampler="Cycles, imported from 8-bit PNG",
        height=min(whole[0], SIDE),
        width=min(whole[1], SIDE),
        numbers=numbers,
        counts=tuple(_slots(images) for images in frames.values()),
        reference_spp=(REFERENCE_SPP,) * len(numbers),
        buffers=buffers,
        lacks=tuple(lacks),
        files=tuple(path for images in frames.values() for path in images.values()),
        read=partial(_read, frames, buffers, whole),
    )


def _check(name: str, frames: Frames) -> None:
    for number, images in frames.items():
        if not _slots(images):
            raise SourceError(f"clip '{name}', frame {number} has no sample 00-{number:04d}.png")
        if "reference" not in images:
            raise SourceError(
                f"clip '{name}', frame {number} has no reference gd{number:04d}.png, "
                "so nothing can be scored on it"
            )


def _slots(images: Mapping[str, Path]) -> int:
    """How many samples there are, up to the first that is missing."""
    return next(slot for slot in range(len(images) + 1) if f"s{slot}" not in images)


def _read(
    frames: Frames, buffers: tuple[str, ...], whole: tuple[int, int], number: int, samples: int
) -> ImportedFrame:
    images = frames[number]
    h, w = min(whole[0], SIDE), min(whole[1], SIDE)
    gbuffer: dict[str, Pixels] = {}
    for buffer in buffers:
        if buffer == "motion":
            there = "motion" in images
            gbuffer[buffer] = _motion(images[buffer], h, w) if there else np.zeros((h, w, 2))
        else:
            value = _png(images[buffer], whole) / 255
            gbuffer[buffer] = value[..., :1] if buffer == "depth" else value
    pool = np.stack([_light(images[f"s{slot}"], whole) for slot in range(samples)])
    reference = _light(images["reference"], whole)
    return ImportedFrame(gbuffer, pool, reference, reference)


def _light(path: Path, whole: tuple[int, int]) -> Pixels:
    """Light of a display that shows the image, [h w 3] in [0, 1]: sRGB's curve is taken off."""
    value = _png(path, whole) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _png(path: Path, whole: tuple[int, int]) -> NDArray[np.uint8]:
    """The pixels of an image that are kept."""
    pixels = read_png(path)
    if pixels.shape[:2] == (720, 1280) and whole == (1080, 1920):  # as the authors' loader
        shown = Image.fromarray(pixels).resize((1920, 1080), Image.Resampling.BILINEAR)
        pixels = np.asarray(shown)
    limits.same_size(path, pixels.shape[:2], whole)
    return pixels[:SIDE, :SIDE]


def _motion(path: Path, h: int, w: int) -> Pixels:
    """Pixels to the previous position, x right and y down, [h w 2], from `grid_sample` coordinates.

    They are those of align_corners=False, (2 x + 1) / w - 1, at the previous position x. The file
    is a pickle in a zip; nothing but tensors is unpickled, after the zip's sizes were looked at.
    Raises SourceError.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > 16 * h * w + 2**16:
            raise SourceError(f"{path} unpacks to {size} bytes, {8 * h * w} are expected")
        grid = torch.load(path, map_location="cpu", weights_only=True)
    except SourceError:
        raise
    except Exception as error:  # the unpickler raises whatever a broken file makes it do
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

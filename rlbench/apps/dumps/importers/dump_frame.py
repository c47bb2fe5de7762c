"""Read one frame of a dump: its images, converted to the conventions of a clip."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import NDArray

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.conversions import (
    convert_albedo,
    convert_depth,
    convert_motion,
    convert_normal,
    decode_curve,
    separate_samples,
)
from rlbench.apps.dumps.importers.layout import Image, Layout
from rlbench.apps.dumps.importers.sequence import ImportedFrame
from rlbench.clips.exr import Window, window_size
from rlbench.clips.image_files import (
    Channels,
    Pixels,
    exr_size,
    find_channels,
    has_channels,
    list_channels,
    read_exr_image,
    to_rec709,
)
from rlbench.errors import SourceError

RGB, XYZ = ("*.R", "*.G", "*.B"), ("*.X", "*.Y", "*.Z")
CHANNELS = {  # usual names, the preferred ones first
    "albedo": (RGB,),
    "normal": (XYZ, RGB),
    "depth": (("*.Z",), ("*.V",), ("*.Y",), ("*.R",), ("*.T",)),
    "motion": (("*.X", "*.Y"), ("*.R", "*.G"), ("*.U", "*.V")),
}
COLOURS = ("radiance", "specular", "emission", "reference", "albedo")
FLIPS = {"no": (), "vertical": (0,), "horizontal": (1,), "both": (0, 1)}
SAMPLE = "{sample}"  # in the name of a channel or a part


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame, by image: samples in order, halves, or one of a buffer."""

    images: Mapping[str, Sequence[Path]]
    reference_spp: int  # of one reference; 0: unknown

    @property
    def paths(self) -> list[Path]:
        """All files."""
        return list(dict.fromkeys(path for paths in self.images.values() for path in paths))

    def without(self, names: Sequence[str]) -> FrameFiles:
        """The files of all other images."""
        return replace(self, images={k: v for k, v in self.images.items() if k not in names})

    def with_references(self, count: int) -> FrameFiles:
        """The files with the first `count` references alone."""
        return replace(self, images={**self.images, "reference": self.images["reference"][:count]})


def count_samples(files: FrameFiles, layout: Layout) -> int:
    """The 1-spp images of a frame, in files of their own or in channels of one.

    Raises SourceError.
    """
    return len(_places(files, "radiance", layout))


def has_image(files: FrameFiles, name: str, layout: Layout) -> bool:
    """Whether the first file of an image has its channels. Raises SourceError."""
    return has_channels(*_places(files, name, layout)[0])


def image_size(files: FrameFiles, name: str, layout: Layout) -> tuple[int, int]:
    """Height and width of the first image of a kind, pixels. Raises SourceError."""
    return exr_size(*_places(files, name, layout)[0])


def find_overscan(frames: Iterable[FrameFiles], layout: Layout) -> Window | None:
    """The window of all pixels of radiance, None where none is outside the display window.

    Raises SourceError.
    """
    headers = [find_channels(*_places(each, "radiance", layout)[0])[0] for each in frames]
    windows = [each.data_window for each in headers] + [each.display_window for each in headers]
    x, y, x_end, y_end = zip(*windows, strict=True)
    window = (min(x), min(y), max(x_end), max(y_end))
    return None if window == headers[0].display_window else window


def read_frame(
    frames: Mapping[int, FrameFiles],
    layout: Layout,
    size: tuple[int, int],
    source: Path,
    first: int,
    window: Window | None,
    number: int,
    samples: int,
) -> ImportedFrame:
    """Frame `number` with the given number of samples. Raises SourceError.

    `first` is the first frame of the dump, to which the first matrix of a camera file belongs.
    `window` is read in place of the display window.
    """
    reader = _Reader(frames[number], layout, size, window)
    gbuffer: dict[str, Pixels] = {}
    if layout.albedo and (stored := reader.read_buffer("albedo")) is not None:
        gbuffer["albedo"] = convert_albedo(stored, layout.albedo)
    if layout.normal and (stored := reader.read_buffer("normal")) is not None:
        rotation = None
        if layout.normal.space == "view" and layout.normal.camera:
            rotation = read_rotation(source / layout.normal.camera, number - first)
        gbuffer["normal"] = convert_normal(stored, layout.normal, rotation)
    if layout.depth and (stored := reader.read_buffer("depth")) is not None:
        gbuffer["depth"] = convert_depth(stored, layout.depth)
    if layout.motion and (stored := reader.read_buffer("motion")) is not None:
        gbuffer["motion"] = _read_motion(stored, frames, layout, reader, number)
    pool = _read_pool(reader, samples, gbuffer)
    halves = [
        _modulate(decode_curve(image, layout.reference.encoding), layout.reference, gbuffer)
        for image in reader.read_all("reference", 2)
    ] or [np.full((*reader.shape, 3), np.nan, np.float32)]
    return ImportedFrame(
        gbuffer=gbuffer,
        pool=pool,
        half_a=halves[0],
        half_b=halves[len(halves) == 2],
        broken=reader.broken_surfaces(gbuffer.get("depth")),
        empty=reader.empty,
        files=reader.nonfinite_files,
        counts=reader.counts,
    )


@dataclass(frozen=True)
class _Reader:
    """Reads the stored images of one frame; counts windows, and marks values that are broken."""

    files: FrameFiles
    layout: Layout
    size: tuple[int, int]  # of the display window
    window: Window | None = None  # that is read in place of it
    counts: Counter[str] = field(default_factory=Counter)
    broken: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    empty: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    nonfinite_files: dict[str, Path] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the images, pixels."""
        return window_size(self.window) if self.window else self.size

    def read_all(self, name: str, most: int) -> list[Pixels]:
        """The first images of a kind; empty where there is none. Raises SourceError."""
        places = _places(self.files, name, self.layout)[:most]
        return [self._read(name, path, channels) for path, channels in places]

    def read_buffer(self, name: str) -> Pixels | None:
        """A buffer, or None where there is none. Raises SourceError."""
        for stored in self.read_all(name, 1):
            is_broken = np.isnan if name == "depth" else lambda values: ~np.isfinite(values)
            mask = np.asarray(is_broken(stored).any(-1, keepdims=True))
            if mask.any() and not (name == "motion" and self.layout.moves_onward):
                self.broken[name] = mask
            return stored
        return None

    def broken_surfaces(self, depth: Pixels | None) -> dict[str, NDArray[np.bool_]]:
        """Where surfaces are broken: what a sky has in place of a normal or of motion is not."""
        if depth is None:
            return self.broken
        surface = np.isfinite(depth)
        if "depth" in self.broken:
            surface |= self.broken["depth"]
        return {name: np.asarray(mask & surface) for name, mask in self.broken.items()}

    def _read(self, name: str, path: Path, channels: Channels) -> Pixels:
        image = self.layout.images[name]
        # what converts to background, black, and no motion
        fill = {"depth": np.inf, "motion": getattr(image, "offset", 0)}.get(name, 0)
        pixels, empty, cut, header = read_exr_image(path, channels, fill, self.window)
        limits.check_same_size(path, header.display_size, self.size)
        if not np.isfinite(pixels).all():
            self.nonfinite_files.setdefault(name, path)
        outside = 0
        if _is_straight(image):
            pixels = pixels[..., :-1] * pixels[..., -1:]
        if name in COLOURS and self.layout.chromaticities == "convert":
            pixels, outside = to_rec709(path, pixels, header)
            if getattr(image, "encoding", "linear") != "linear" and header.primaries:
                raise SourceError(
                    f"{path}: [{name}] is encoded as sRGB, and the file has chromaticities of "
                    "another space; convert it to linear Rec. 709"
                )
        for kind, count in (("empty", int(empty.sum())), ("cut", cut), ("outside", outside)):
            self.counts[f"{kind} pixels"] += count
            self.counts[f"{kind} images"] += count > 0
        self.empty[name] = np.flip(empty, FLIPS[image.flip])
        return np.flip(pixels, FLIPS[image.flip])


def _places(files: FrameFiles, name: str, layout: Layout) -> list[tuple[Path, Channels]]:
    """File and channels of each image of a kind: a file each, or the samples in one of them."""
    image, paths = layout.images[name], files.images.get(name, ())
    channels = image_channels(name, layout)
    if not paths or SAMPLE not in image.part + "".join(image.channel_names):
        return [(path, channels) for path in paths]

    def fill(text: str, slot: str) -> str:
        return text.replace(SAMPLE, slot)

    return [
        (
            paths[0],
            Channels(
                [[fill(channel, slot) for channel in names] for names in channels.alternatives],
                fill(image.part, slot),
                layout.layer,
            ),
        )
        for slot in _slots(paths[0], image)
    ]


def image_channels(name: str, layout: Layout) -> Channels:
    """Where an image of the layout is in its files."""
    image = layout.images[name]
    return Channels(_alternatives(name, image), image.part, layout.layer)


def _alternatives(name: str, image: Image) -> Sequence[Sequence[str]]:
    """The names of the channels of an image, or the usual ones, as alternatives."""
    usual = CHANNELS.get(name, (RGB, XYZ))
    alternatives = (image.channel_names,) if image.channel_names else usual
    if _is_straight(image):
        return [[*names, re.sub(r"\w+$", "A", names[0])] for names in alternatives]
    return alternatives


def _is_straight(image: Image) -> bool:
    return getattr(image, "alpha", "") == "straight"


def _slots(path: Path, image: Image) -> list[str]:
    """The numbers of the samples in one file, as they are written; the first may be any.

    Raises SourceError where there is none, or one between the first and the last is missing.
    """
    parts = list_channels(path)
    if SAMPLE in image.part:
        pattern, names = image.part, list(parts)
    else:
        pattern = next(channel for channel in image.channel_names if SAMPLE in channel)
        names = [each for part, channels in parts.items() for each in _aliases(part, channels)]
    head, *tails = (re.escape(text).replace(r"\*", ".*") for text in pattern.split(SAMPLE))
    expression = re.compile(head + r"(\d+)" + r"\1".join(tails))
    found = {int(match[1]): match[1] for match in map(expression.fullmatch, names) if match}
    numbers = sorted(found)
    if not numbers or numbers != list(range(numbers[0], numbers[-1] + 1)):
        listed = f"those numbered {', '.join(map(str, numbers))}" if numbers else ", ".join(names)
        raise SourceError(f"{path}: expected '{pattern}' numbered without gaps; it has: {listed}")
    return [found[number] for number in numbers]


def _aliases(part: str, channels: Sequence[str]) -> Iterator[str]:
    """The names of the channels of a part, without and with it."""
    yield from channels
    yield from (f"{part}.{channel}" for channel in channels if part)


def _read_pool(reader: _Reader, samples: int, gbuffer: Mapping[str, Pixels]) -> Pixels:
    """The samples [s h w 3]: light, times albedo if it is demodulated, and what is added to it."""
    layout, files = reader.layout, reader.files
    total: Pixels | None = None
    for name, image in (("radiance", layout.radiance), ("specular", layout.specular)):
        if image is None or not files.images.get(name):
            continue
        stored = [decode_curve(v, image.encoding) for v in reader.read_all(name, samples)]
        light = separate_samples(stored) if image.samples == "accumulated" else stored
        part = np.stack([_modulate(each, image, gbuffer) for each in light])
        if total is not None and len(part) != len(total):
            raise SourceError(
                f"{files.images[name][0]}: [{name}] has {len(part)} samples, [radiance] has "
                f"{len(total)}"
            )
        total = part if total is None else total + part
    assert total is not None
    for emission in reader.read_all("emission", 1) if layout.emission else ():
        total = total + emission
    return total


def _read_motion(
    stored: Pixels,
    frames: Mapping[int, FrameFiles],
    layout: Layout,
    reader: _Reader,
    number: int,
) -> Pixels:
    """Motion to the previous frame; zero in a first frame whose motion is in no file."""
    assert layout.motion is not None
    if not layout.moves_onward:
        return convert_motion(stored, layout.motion)
    if number - 1 not in frames:
        return np.zeros((*reader.shape, 2), np.float32)
    (previous,) = replace(reader, files=frames[number - 1]).read_all("motion", 1)
    return convert_motion(stored, layout.motion, previous)


def _modulate(light: Pixels, image: Image, gbuffer: Mapping[str, Pixels]) -> Pixels:
    """Light times albedo where it is demodulated. Raises SourceError without albedo."""
    if not getattr(image, "demodulated", False):
        return light
    if "albedo" not in gbuffer:
        raise SourceError("demodulated light needs albedo, and the dump has no file of [albedo]")
    return light * gbuffer["albedo"]


def read_rotation(path: Path, index: int) -> Float[Array, "3 3"]:
    """The rotation of one camera-to-world matrix in a JSON file. Raises SourceError."""
    try:
        document = json.loads(path.read_text("utf-8-sig"))
        matrices = document["camera_to_world"] if isinstance(document, dict) else document
        matrix = np.array(matrices[index], np.float64)
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise SourceError(
            f"{path} holds no camera-to-world matrix {index}: expected a JSON list of 4 x 4 "
            f"matrices, one a frame ({error!r})"
        ) from error
    if matrix.shape not in ((4, 4), (3, 3)) or not np.isfinite(matrix).all():
        raise SourceError(f"{path}: matrix {index} is of shape {matrix.shape}, expected 4 x 4")
    columns = matrix[:3, :3]
    return np.asarray(columns / np.linalg.norm(columns, axis=0))

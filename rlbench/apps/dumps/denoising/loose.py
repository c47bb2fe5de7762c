"""Loose images: a noisy one, and its albedo, normals, depth or motion in other files.

Each is a file, a folder with one file a frame, or a pattern of file names such as `color.####.exr`.
Images of one frame have the same number; single files belong together whatever their names are.
Without a layout, an image has the channels of Blender, or the usual ones (R, G, B; X, Y, Z; Z), in
the conventions of a clip. `FILES:LAYER` reads one layer of files that have several.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from rlbench.apps.dumps.importers.dump import Clips
from rlbench.apps.dumps.importers.dump_frame import CHANNELS, image_channels
from rlbench.apps.dumps.importers.file_pattern import FileKey, SignReader
from rlbench.apps.dumps.importers.layout import (
    Albedo,
    Depth,
    Image,
    Layout,
    Motion,
    Normal,
    Radiance,
    Reference,
    read_layout,
)
from rlbench.clips.image_files import Channels, Pixels, find_channels, has_channels, read_exr
from rlbench.errors import SourceError

__all__ = ["IMAGES", "LooseImage", "is_blender", "match_loose_images", "parse_loose_image"]

IMAGES = {"albedo": Albedo, "normal": Normal, "depth": Depth, "motion": Motion}
COMBINED = tuple(f"*.Combined.{letter}" for letter in "RGB")
LETTERS = {"normal": ("XYZ", "RGB"), "depth": ("Z", "V", "Y", "R"), "motion": ("XY", "RG", "UV")}
NUMBER = re.compile(r"\{frame\}|#+|%0?\d*d")  # of a frame, in a pattern
SPECIAL = re.compile(r"[\[\]{}*]")  # characters that mean something in a layout's pattern
UNIT_TOLERANCE = 0.02  # deviation of a length from 1; half precision causes 0.001


@dataclass(frozen=True)
class LooseImage:
    """The files of one image."""

    folder: Path
    files: Mapping[int, Path]  # by the number of the frame
    pattern: str  # of their names, as a layout has it
    layer: str = ""  # of their channels; empty: the usual ones
    is_single: bool = False  # one file that was named, whatever its number is

    @property
    def first(self) -> Path:
        """The file of the first frame."""
        return self.files[min(self.files)]


def parse_loose_image(text: Path | str) -> LooseImage:
    """The files that a path, a folder or a pattern means, with or without a layer after a colon.

    Raises SourceError where there are none, or where two files are the same frame.
    """
    path, layer = Path(text), ""
    if ":" in path.name and not path.exists():
        name, _, layer = path.name.rpartition(":")
        path = path.with_name(name)
    if path.is_file():
        pattern = SPECIAL.sub("*", path.name)
        return LooseImage(path.parent, {0: path}, pattern, layer, is_single=True)
    if path.is_dir():
        pattern = "*[{frame}].exr"
        return LooseImage(path, _number(path, pattern), pattern, layer)
    if not (number := NUMBER.search(path.name)):
        raise SourceError(
            f"there is no file {path}. Give an EXR file, a folder of them, or a pattern such as "
            "color.####.exr"
        )
    head, tail = path.name[: number.start()], path.name[number.end() :]
    pattern = f"{SPECIAL.sub('*', head)}{{frame}}{SPECIAL.sub('*', tail)}"
    return LooseImage(path.parent, _number(path.parent, pattern), pattern, layer)


def _number(folder: Path, pattern: str) -> dict[int, Path]:
    """The files of a folder that match a pattern, by number of frame. Raises SourceError."""
    if not folder.is_dir():
        raise SourceError(f"there is no folder {folder}")
    paths = [each for each in sorted(folder.iterdir()) if each.is_file()]
    names = [PurePath(each.name) for each in paths if not each.name.startswith(".")]
    patterns = [pattern, re.sub(r"\.exr$", ".EXR", pattern)]
    signs, found = SignReader(names, patterns), dict[int, Path]()
    for name in names:
        key = next(filter(None, (signs.match(each, name) for each in patterns)), None)
        if key is None:
            continue
        if key.frame in found:
            raise SourceError(
                f"{folder}: {found[key.frame].name} and {name} are one frame. Name one of the "
                f"images by a pattern, such as {folder / 'color.####.exr'}, and the others with "
                "--albedo and --normal; or give a --layout (rlbench lint --guess writes one)"
            )
        found[key.frame] = folder / name
    if not found:
        others = ", ".join(sorted(each.name for each in paths)[:8]) or "nothing"
        raise SourceError(f"{folder} has no file {pattern}; it holds: {others}")
    return found


def is_blender(file: Path, layer: str = "") -> bool:
    """Whether a file has the pass Combined of Blender. Raises SourceError for a broken file."""
    return has_channels(file, Channels([COMBINED], layer=layer))


def match_loose_images(
    radiance: LooseImage, others: Mapping[str, LooseImage], layout: Layout | None, layer: str = ""
) -> tuple[Layout, Clips]:
    """The layout of loose images, and their files by clip, frame and image.

    `others` are by the name of a table of a layout. A `layout` says the conventions, and which
    images are in the files of `radiance`; without one it is that of Blender where they have its
    channels. Raises SourceError where a file lacks the channels of its image.
    """
    base = layout or _guess_layout(radiance, radiance.layer or layer)
    tables: dict[str, Any] = dict.fromkeys((*base.images, "camera"))
    for name, table in base.images.items():
        if set(table.patterns) & set(base.radiance.patterns):
            tables[name] = replace(table, files=radiance.pattern)
    for name, image in others.items():
        tables[name] = _table(name, getattr(layout, name, None), image)
    tables["reference"] = Reference(files=radiance.pattern)  # which every layout has
    base = replace(base, **tables)
    for name, image in others.items():
        find_channels(image.first, image_channels(name, base))
        if image.is_single != radiance.is_single:
            kinds = [
                f"{'one file' if each.is_single else 'a sequence'}" for each in (radiance, image)
            ]
            raise SourceError(f"{radiance.first} is {kinds[0]}, and --{name} is {kinds[1]}")
    files = {name: others.get(name, radiance).files for name in base.images}
    frames = {
        number: {
            name: {FileKey(frame=number): (0, each[number])}
            for name, each in files.items()
            if number in each
        }
        for number in radiance.files
    }
    return base, {"": frames}


def _guess_layout(radiance: LooseImage, layer: str) -> Layout:
    """The layout of Blender for files with its channels, else one of the usual channels alone."""
    channels = tuple(f"{layer}.{letter}" for letter in "RGB") if layer else ()
    is_plain = _has(radiance.first, channels) if layer else not is_blender(radiance.first)
    if is_plain:
        image = Radiance(files=radiance.pattern, channels=channels)
        return Layout(radiance=image, reference=Reference(files=image.files))
    return replace(read_layout("blender"), layer=layer)


def _table(name: str, given: Image | None, image: LooseImage) -> Image:
    """The table of a layout for files that were named; normals of no layout are looked at."""
    table = replace(given or IMAGES[name](files=""), files=image.pattern)
    if image.layer:
        table = replace(table, channels=_layer_channels(name, image))
    if isinstance(table, Normal) and given is None:
        table = replace(table, space="unknown", encoded=_is_encoded(image.first, table))
    return table


def _layer_channels(name: str, image: LooseImage) -> tuple[str, ...]:
    """The channels of a layer that suit an image. Raises SourceError where it has none."""
    alternatives = [
        tuple(f"{image.layer}.{letter}" for letter in letters)
        for letters in LETTERS.get(name, ("RGB",))
    ]
    fitting = (each for each in alternatives if _has(image.first, each))
    return next(fitting, None) or alternatives[0]


def _has(file: Path, channels: Sequence[str]) -> bool:
    return has_channels(file, Channels([channels]))


def _is_encoded(file: Path, table: Normal) -> bool:
    """Whether normals are stored as (n + 1) / 2: whether more of them have unit length then."""
    alternatives = [table.channel_names] if table.channel_names else CHANNELS["normal"]
    if not has_channels(file, Channels(alternatives)):
        return False  # which is said when they are read
    pixels = np.asarray(read_exr(file, alternatives), np.float64)
    plain, decoded = _unit_shares(pixels)
    return decoded > plain and bool(np.nanmin(pixels) >= 0)


def _unit_shares(pixels: Pixels) -> Iterator[float]:
    """The shares of vectors [h w 3] that have unit length: as they are, and decoded."""
    for vectors in (pixels, 2 * pixels - 1):
        yield float((np.abs(np.linalg.norm(vectors, axis=-1) - 1) < UNIT_TOLERANCE).mean())

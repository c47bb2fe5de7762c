"""Guess from names which files and channels of a dump hold which image."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from rlbench.clips.importers import limits
from rlbench.clips.importers.image_files import list_channels
from rlbench.clips.importers.sequence import SourceError

__all__ = ["NamedImage", "find_named_images"]

WORDS = {  # of files, folders, layers and parts; the first image with such a word wins
    "reference": ("reference", "ref", "converged", "groundtruth", "gt", "target"),
    "motion": (
        "motionvectors",
        "motionvector",
        "motion",
        "mvec",
        "mv",
        "velocity",
        "vector",
        "flow",
    ),
    "normal": ("worldnormal", "shnormal", "normals", "normal", "normw", "nrm", "nn"),
    "depth": ("worlddepth", "linearz", "viewz", "depth", "dist", "distance", "zdepth", "dd"),
    "albedo": ("denoisingalbedo", "basecolor", "diffuseopacity", "albedo", "diffcol", "alb"),
    "emission": ("emission", "emissive", "emit"),
    "radiance": ("radiance", "combined", "beauty", "noisy", "color", "colour", "hdr", "sample"),
}
CHANNELS = {  # endings of the channels of each image, the preferred ones first
    "reference": ("RGB",),
    "radiance": ("RGB",),
    "albedo": ("RGB",),
    "emission": ("RGB",),
    "normal": ("XYZ", "RGB"),
    "depth": ("Z", "V", "Y", "R", "T"),
    "motion": ("XY", "RG", "UV"),
}
NUMBER = re.compile(r"\d+")
SAMPLE_WORDS = ("sample", "seed", "s")


class NamedImage(NamedTuple):
    """Where an image is, by its names."""

    pattern: str  # of its files
    channels: tuple[str, ...]
    part: str

    def to_table(self) -> dict[str, object]:
        """The keys of a layout's table."""
        table: dict[str, object] = {"files": self.pattern, "channels": list(self.channels)}
        return table | ({"part": self.part} if self.part else {})


def find_named_images(source: Path) -> dict[str, NamedImage]:
    """The images of a dump by the name of their table. Raises SourceError without radiance.

    Numbers in the names of files that vary are frames, samples after the word sample or seed, and
    samples per pixel before spp.
    """
    paths = [path for path in limits.list_files(source) if path.suffix.lower() == ".exr"]
    if not paths:
        raise SourceError(f"{source} holds no EXR file, so no layout can be guessed")
    groups: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        groups[_pattern(path.relative_to(source).as_posix())].append(path)
    found: dict[str | None, NamedImage] = {}
    for pattern, files in sorted(groups.items()):
        for name, image in _images(pattern, files[0]):
            found.setdefault(name, image)
    if unnamed := found.pop(None, None):
        found.setdefault("radiance", unnamed)
    for name in ("radiance", "reference"):
        if name not in found:
            raise SourceError(
                f"{source}: no image looks like {name}; its names should contain one of "
                f"{', '.join(WORDS[name])}. Found: {', '.join(sorted(groups)[:8])}"
            )
    return {name: image for name, image in found.items() if name}


def _pattern(path: str) -> str:
    """The pattern of a file: its last number is the frame, others by the word beside them.

    >>> _pattern("sample3/view.0012.exr")
    'sample{sample}/view.{frame}.exr'
    >>> _pattern("frame0007/noisy_seed2_0001spp.exr")
    'frame{frame}/noisy_seed{sample}_{spp}spp.exr'
    """
    matches = list(NUMBER.finditer(path))
    kinds: dict[int, str] = {}
    for index, match in enumerate(matches):
        word = re.search(r"([A-Za-z]*)[_.-]?$", path[: match.start()])
        if path[match.end() :].startswith("spp"):
            kinds[index] = "spp"
        elif word and word[1].lower() in SAMPLE_WORDS:
            kinds[index] = "sample"
    if rest := [index for index in range(len(matches)) if index not in kinds]:
        kinds[rest[-1]] = "frame"
    text = path
    for index in sorted(kinds, reverse=True):
        match = matches[index]
        text = f"{text[: match.start()]}{{{kinds[index]}}}{text[match.end() :]}"
    return re.sub(r"(?i)(reference|ref|half)([AB])(?=[/._-])", r"\1{half}", text)


def _images(pattern: str, path: Path) -> Iterator[tuple[str | None, NamedImage]]:
    """The images that one file holds, with the names of their tables; None: named by no word."""
    base = _classify([re.sub(r"\{\w+\}|\.exr$", "", pattern)])
    for part, channels in list_channels(path).items():
        for layer, letters in _layers(channels).items():
            name = _classify([layer, part]) or (base if not layer or not part else None)
            name = name or (base if base else None)
            if base == "reference":
                name = "reference" if name in (None, "radiance", "reference") else None
            for endings in CHANNELS[name or "radiance"]:
                if set(endings) <= letters.keys():
                    yield name, NamedImage(pattern, tuple(letters[e] for e in endings), part)
                    break


def _layers(channels: Iterable[str]) -> Mapping[str, dict[str, str]]:
    """Channels by layer, and then by the letter at their end."""
    layers: dict[str, dict[str, str]] = defaultdict(dict)
    for channel in channels:
        layer, _, letter = channel.rpartition(".")
        layers[layer][letter.upper()] = channel
    return layers


def _classify(texts: Iterable[str]) -> str | None:
    """The image that names suggest, by their words, or None."""
    for text in texts:
        words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", text)]
        joined = "".join(words)
        for name, known in WORDS.items():
            if any(word in words or (len(word) > 4 and word in joined) for word in known):
                return name
    return None

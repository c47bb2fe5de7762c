"""Guess from names which files and channels of a dump hold which image, and what no name claims.

A name is only a first guess: an image whose values contradict its name is passed over.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.dump_frame import CHANNELS as USUAL_CHANNELS
from rlbench.apps.dumps.importers.file_pattern import match_pattern
from rlbench.apps.dumps.importers.layout import Layout
from rlbench.apps.dumps.lint.file_numbers import find_patterns
from rlbench.clips.header import FILE
from rlbench.clips.image_files import Pixels, list_channels, read_exr
from rlbench.errors import SourceError

WORDS = {  # of layers, parts, files and folders, the preferred first; the longest that fits counts
    "reference": ("reference", "ref", "converged", "groundtruth", "gt", "target"),
    "motion": (
        *("motionvectors", "motionvector", "mvec", "mv", "motionback", "velocity", "vector"),
        *("motion", "backward", "flow"),
    ),
    "normal": (
        *("worldnormal", "shnormal", "normals", "normal", "normw", "nrm", "nn", "n"),
        "denoisingnormal",  # in camera space, of Cycles
    ),
    "depth": (
        *("worlddepth", "linearz", "viewz", "depth", "zdepth", "z", "dist", "distance", "dd"),
        *("denoisingdepth", "devicez"),
    ),
    "albedo": (
        *("denoisingalbedo", "basecolor", "diffuseopacity", "diffusealbedo", "albedo"),
        *("diffusefilter", "diffcol", "alb"),
    ),
    "emission": ("emission", "emissive", "emit"),
    "radiance": (
        *("combined", "beauty", "noisy", "radiance", "finalimage", "rgba", "ci", "c"),
        *("hdr", "color", "colour", "sample"),
    ),
}
PARTS_OF_LIGHT = (  # words of images that are added to others, and are never the whole
    *("emission", "emissive", "emit", "env", "environment", "envlight", "direct", "indirect"),
    *("specular", "glossy", "transmission", "subsurface", "sss", "coat", "sheen", "volume"),
    *("background", "shadow", "ambient", "lightgroup", "caustics"),
)
VAGUE = ("hdr", "color", "colour", "sample")  # words of radiance that many a layer has
ENDINGS: dict[
    str, tuple[Sequence[str], ...]
] = {  # of the channels of each image, the preferred ones first; "": a channel of its own
    "reference": ("RGB",),
    "radiance": ("RGB",),
    "albedo": ("RGB",),
    "emission": ("RGB",),
    "normal": ("XYZ", "RGB"),
    "depth": ("Z", "V", "Y", "R", "T", ("",)),
    "motion": ("XY", "RG", "UV"),
}
HINTS = {  # what a name means that cannot be read
    "dpcameradtime": "the velocity in camera space; write motion in pixels, as by motionBack",
    "dpdtime": "the velocity in world space; write motion in pixels",
    "a": "alpha",
    "motionfore": "motion to the next frame; motionBack is that to the previous one",
}
ENDING_COLOURS = (("*.R", "*.G", "*.B"), ("*.X", "*.Y", "*.Z"))  # where a layout names no channels
UNIT_TOLERANCE = 0.02  # deviation of a length from 1; half precision causes 0.001
MAX_PIXELS = 2**18  # of an image, that suffice to judge its values


class NamedImage(NamedTuple):
    """Where an image is, by its names."""

    pattern: str  # of its files
    channels: tuple[str, ...]
    part: str

    def to_table(self) -> dict[str, object]:
        """The keys of a layout's table."""
        table: dict[str, object] = {"files": self.pattern, "channels": list(self.channels)}
        return table | ({"part": self.part} if self.part else {})


class _Candidate(NamedTuple):
    """An image that names suggest, the better the lower its rank."""

    rank: tuple[int, int, int]
    image: NamedImage
    path: Path  # of its first file


def find_named_images(source: Path) -> dict[str, NamedImage]:
    """The images of a dump by the name of their table. Raises SourceError without radiance.

    Where no name says which image is the reference, and names count samples per pixel, it is that
    of the most.
    """
    candidates: dict[str, list[_Candidate]] = defaultdict(list)
    groups = _read_groups(source)
    for pattern, path in groups.items():
        for name, candidate in _candidates(pattern, path):
            candidates[name].append(candidate)
    candidates["radiance"] += candidates.pop("", [])
    found = {}
    for name in WORDS:
        ranked = sorted(candidates[name], key=lambda each: each.rank)
        fitting = (each.image for each in ranked if _has_values_of(name, each))
        if image := next(fitting, None):
            found[name] = image
    if "radiance" in found and "{spp}" in found["radiance"].pattern:
        found.setdefault("reference", found["radiance"])
    if "radiance" not in found:
        raise SourceError(
            f"{source}: no image looks like radiance; its names should contain one of "
            f"{', '.join(WORDS['radiance'])}. Found: {', '.join(sorted(groups)[:8])}"
        )
    return found


def _read_groups(source: Path) -> dict[str, Path]:
    """The patterns of the EXR files of a dump, each with its first file; newer versions first."""
    if (source / FILE).is_file():
        raise SourceError(f"{source} is a clip already: rlbench lint {source} checks it")
    paths = [path for path in limits.list_files(source) if path.suffix.lower() == ".exr"]
    if not paths:
        content = ", ".join(sorted(path.name for path in source.iterdir())[:8]) or "nothing"
        raise SourceError(
            f"{source} holds no EXR file, so no layout can be guessed; it holds: {content}"
        )
    names = [path.relative_to(source).as_posix() for path in paths]
    patterns = find_patterns(names, lambda text: classify(text) == ("reference", 0))

    def version(pattern: str) -> list[int]:
        return [-int(number) for number in re.findall(r"\d+", pattern)]

    ordered = sorted(patterns, key=lambda pattern: (re.sub(r"\d+", "#", pattern), version(pattern)))
    return {pattern: source / patterns[pattern][0] for pattern in ordered}


def _candidates(pattern: str, path: Path) -> Iterator[tuple[str, _Candidate]]:
    """The images that a file may hold, with the names of their tables; empty: named by no word."""
    base = classify(re.sub(r"\{\w+\}|\.exr$", "", pattern))
    for part, channels in list_channels(path).items():
        for layer, letters in _layers(channels).items():
            name, rank = _name_layer(layer, part, base)
            if base[0] == "reference":
                if name not in ("", "radiance", "reference"):
                    continue
                name = "reference"
            endings = next((e for e in ENDINGS[name or "radiance"] if set(e) <= letters.keys()), ())
            if endings:
                image = NamedImage(pattern, tuple(letters[e] for e in endings), part)
                text = re.sub(
                    r"(?<=v)\d+", "", f"{pattern} {part} {layer}"
                )  # versions are in order
                if name in ("", "radiance", "reference") and _is_part_of_light(text):
                    continue
                # of images by one word the shortest name is the whole, before color2; unnamed last
                yield name, _Candidate((rank[0] + 5 * (not name), rank[1], len(text)), image, path)


def _is_part_of_light(text: str) -> bool:
    """Whether a word of a name says that an image is added to others."""
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", text)]
    return not set(PARTS_OF_LIGHT).isdisjoint(words)


def _name_layer(layer: str, part: str, base: tuple[str, int]) -> tuple[str, tuple[int, int]]:
    """The image that a layer, else its part, else its file suggests, and the rank of that."""
    level, (name, place) = 0, classify(layer)
    if not name:
        level, (name, place) = 1, classify(part)
    if name == "radiance" and WORDS[name][place] in VAGUE:
        level = 3
    if not name:  # a named layer that no word tells is hardly what its file is
        level, (name, place) = 4 if layer or part else 2, base
    level += 10 * ("composite" in layer.lower())  # what a compositor made of it
    return name, (level, place)


def _layers(channels: Iterable[str]) -> Mapping[str, dict[str, str]]:
    """Channels by layer, and then by the letter at their end.

    Z beside colours is a layer of its own, and so is a word without a dot; their letter is empty.

    >>> dict(_layers(["Ci.r", "Ci.g", "z", "depth"]))
    {'Ci': {'R': 'Ci.r', 'G': 'Ci.g'}, 'z': {'': 'z'}, 'depth': {'': 'depth'}}
    """
    names = list(channels)
    letters = {name.upper() for name in names}
    layers: dict[str, dict[str, str]] = defaultdict(dict)
    for name in names:
        layer, _, letter = name.rpartition(".")
        is_own = not layer and (len(name) > 1 or (letter.upper() == "Z" and "X" not in letters))
        if is_own or len(letter) > 1:
            layers[name][""] = name
        else:
            layers[layer][letter.upper()] = name
    return layers


def classify(text: str) -> tuple[str, int]:
    """The image that a name suggests by its longest known word, and the word's place in the list.

    Words of one letter must be all of a layer's own name; other short ones a word of the text.

    >>> classify("ViewLayer.Denoising Albedo"), classify("VRayZDepth"), classify("diffuse_albedo")
    (('albedo', 0), ('depth', 4), ('albedo', 3))
    >>> classify("crypto")
    ('', 0)
    """
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", text)]
    joined = "".join(words).replace("irradiance", "")
    leaf = re.split(r"[./]", text.strip("._-/ "))[-1].lower()
    for name, known in WORDS.items():
        fitting = [
            word
            for word in known
            if word == leaf
            or (len(word) > 1 and word in words)
            or (len(word) > 4 and word in joined)
        ]
        if fitting:
            return name, known.index(max(fitting, key=len))
    return "", 0


def _has_values_of(name: str, candidate: _Candidate) -> bool:
    """Whether the values of an image are possible for what its name says."""
    values = _read_values(candidate.path, candidate.image.channels, candidate.image.part)
    finite = values[np.isfinite(values).all(-1)]
    if not len(finite):
        return name == "depth"
    if name == "normal":
        return max(_unit_share(finite), _unit_share(2 * finite - 1)) > 0.5
    if name == "albedo":
        return bool(finite.min() >= -1e-3) and _unit_share(finite) < 0.9
    return True


def _read_values(path: Path, channels: Sequence[str], part: str) -> Pixels:
    """The pixels [n c] of an image, or every k-th of a large one."""
    pixels = np.asarray(read_exr(path, [channels], part), np.float64).reshape(-1, len(channels))
    return pixels[:: -(-len(pixels) // MAX_PIXELS)]


def _unit_share(vectors: Pixels) -> float:
    """The share of vectors that have unit length, of those that are not 0."""
    length = np.linalg.norm(vectors, axis=-1)
    length = length[length > 1e-3]
    return float((np.abs(length - 1) < UNIT_TOLERANCE).mean()) if len(length) else 0.0


def list_unclaimed(source: Path, layout: Layout) -> list[str]:
    """The channels of a dump that no image of the layout reads: range, and what they could be.

    One line a layer, as in `ViewLayer.Mist.Z (view.{frame}.exr): 0 to 1, a mask, ...`. Layers that
    are read from other files are left out.
    """
    claimed: set[str] = set()
    found: dict[str, tuple[list[str], str]] = {}  # by layer: its channels and the line
    for pattern, path in _read_groups(source).items():
        relative = path.relative_to(source)
        for part, channels in list_channels(path).items():
            for layer, letters in _layers(channels).items():
                read = {n for n in letters.values() if _is_read(layout, relative, part, n)}
                is_file = not (part or layer or read) and len(letters) > 1  # an image of its own
                key = pattern if is_file else f"{part}:{layer}"
                claimed |= {f"{key} {name}" for name in read}
                free = [name for name in letters.values() if name not in read]
                if free and key not in found:
                    what = _describe(_read_values(path, free, part), free, bool(read))
                    label = f"{part}: " * bool(part) + ", ".join(free)
                    found[key] = (free, f"{label} ({pattern}): {what}")
    return [
        line
        for key, (free, line) in found.items()
        if not any(f"{key} {name}" in claimed for name in free)
    ]


def _is_read(layout: Layout, path: PurePath, part: str, channel: str) -> bool:
    """Whether an image of the layout reads a channel of a file."""
    for table, image in layout.images.items():
        if not any(match_pattern(pattern, path) for pattern in image.patterns):
            continue
        if image.part and not fnmatchcase(part, image.part.replace("{sample}", "*")):
            continue
        names = image.channel_names or [
            name for names in USUAL_CHANNELS.get(table, ENDING_COLOURS) for name in names
        ]
        alpha = (
            [re.sub(r"\w+$", "A", names[0])] if getattr(image, "alpha", "") == "straight" else []
        )
        for name in (*names, *alpha):
            pattern = name.replace("{sample}", "*")
            if fnmatchcase(channel, pattern) or fnmatchcase(f"{part}.{channel}", pattern):
                return True
            if pattern.startswith("*.") and channel.upper() == pattern[2:].upper():
                return True
    return False


def _describe(values: Pixels, channels: Sequence[str], is_rest: bool) -> str:
    """The range of channels that nothing claims, and what they could be."""
    finite = values[np.isfinite(values).all(-1)]
    if not len(finite):
        return "nothing finite"
    low, high = float(finite.min()), float(finite.max())
    return f"{low:.3g} to {high:.3g}, {_guess_content(finite, channels, is_rest)}"


def _guess_content(finite: Pixels, channels: Sequence[str], is_rest: bool) -> str:
    """What channels could be, by their name, else by their values [n c]."""
    low, high = float(finite.min()), float(finite.max())
    named = [HINTS[word] for word in channels[0].lower().split(".") if word in HINTS]
    if named or low == high or is_rest:
        return [*named, "a constant" if low == high else "the rest of a layer that is read"][0]
    is_share = low >= 0 and high <= 1
    if len(channels) == 1:
        is_whole = bool((finite == finite.round()).all())
        scalar = "a mask, an opacity or scaled depth" if is_share else "depth"
        return f"could be {'ids or a mask' if is_whole else scalar}"
    if len(channels) > 2 and _unit_share(finite[:, :3]) > 0.5:
        return "could be normals, or other directions"
    if len(channels) == 2:
        return "could be texture coordinates" if is_share else "could be motion"
    if low < 0:
        return "could be positions, motion or a velocity"
    return "could be albedo, or another colour" if is_share else "could be light"

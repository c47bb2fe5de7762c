"""The layout of a dump: a TOML file says which files hold which image, and in which convention."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from rlbench.errors import SourceError
from rlbench.registry.near_names import suggest, unknown_name
from rlbench.system.documents import decode, read_toml

Words = str | tuple[str, ...]
Curve = Literal["linear", "srgb"]
Alpha = Literal["premultiplied", "straight"]


@dataclass(frozen=True, kw_only=True)
class Image:
    """Where an image is: files below the dump, a part and channels in them.

    `files` is a pattern (see `file_pattern.py`), or several, the preferred one
    first. `channels` may contain `*`; empty: the usual names. `part` names a part of a multi-part
    file; empty: any part. `flip` undoes a mirrored image.
    """

    files: Words
    channels: Words = ()
    part: str = ""
    flip: Literal["no", "vertical", "horizontal", "both"] = "no"

    @property
    def patterns(self) -> tuple[str, ...]:
        """The patterns of `files`."""
        return _as_tuple(self.files)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """The names in `channels`."""
        return _as_tuple(self.channels)


@dataclass(frozen=True, kw_only=True)
class Radiance(Image):
    """Noisy images of 1 spp, one per sample; or means of the first 1, 2, 3, ... samples.

    `demodulated` light is multiplied by albedo, light with `straight` alpha by its channel A.
    """

    samples: Literal["separate", "accumulated"] = "separate"
    encoding: Curve = "linear"
    alpha: Alpha = "premultiplied"
    demodulated: bool = False


@dataclass(frozen=True, kw_only=True)
class Reference(Image):
    """The converged image. `spp` is that of both halves together; 0: from the name, or unknown.

    `jittered`: it is moved within the pixel as the samples are. `optional`: frames may have none.
    """

    spp: int = 0
    optional: bool = False
    jittered: bool = False
    encoding: Curve = "linear"
    alpha: Alpha = "premultiplied"
    demodulated: bool = False


@dataclass(frozen=True, kw_only=True)
class Albedo(Image):
    """Reflectance, times `scale`."""

    encoding: Curve = "linear"
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Normal(Image):
    """Normals; `encoded` ones are (n + 1) / 2. `axes` are the stored ones along the world's x y z.

    `camera` is a JSON file of camera-to-world matrices, one a frame of the dump, that rotates
    normals in view space: its columns 0 to 2 are the view's axes.
    """

    space: Literal["world", "view", "unknown"] = "world"
    encoded: bool = False
    axes: tuple[str, str, str] = ("x", "y", "z")
    camera: str = ""


@dataclass(frozen=True, kw_only=True)
class Depth(Image):
    """Depth of one of five kinds, with the value of background.

    Stored values of at least `far` (of at most it, if it is negative) and those equal to
    `background` are background. `near` and `far_plane` belong to z-buffers, `fov` (horizontal,
    degrees) to distances to the camera.
    """

    kind: Literal["view", "distance", "inverse", "z-buffer", "reversed z-buffer"] = "view"
    scale: float = 1.0
    far: float | None = None
    background: float | None = None
    near: float | None = None
    far_plane: float = float("inf")
    fov: float | None = None


@dataclass(frozen=True, kw_only=True)
class Motion(Image):
    """Motion vectors: (stored - offset) * scale in `unit`, at the pixels of the frame they are in.

    "from previous" is the negative of "to previous". "to next" points into the next frame.
    `jittered` vectors contain the difference of the camera's jitter, which is taken out.

    `sky` says whose motion background has: its own ("stored"), that of a turning camera, or an
    "unknown" one, which points outside; "auto" takes its own unless it is 0 while surfaces move.
    The camera is known by `camera`, a JSON file as for normals, and `fov` (horizontal, degrees), by
    default those of [normal] and [depth]. `camera_axes` are the matrices' axes along right, down
    and forward of the image.
    """

    unit: Literal["pixels", "ndc", "shares"] = "pixels"
    y: Literal["down", "up"] = "down"
    points: Literal["to previous", "from previous", "to next", "from next"] = "to previous"
    scale: float = 1.0
    offset: float = 0.0
    jittered: bool = False
    sky: Literal["auto", "stored", "unknown"] = "auto"
    camera: str = ""
    fov: float | None = None
    camera_axes: tuple[str, str, str] = ("x", "-y", "-z")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """How the camera moves within a pixel from frame to frame, for antialiasing over time.

    `jitter` is "halton PERIOD", of bases 2 and 3 minus 0.5, or a text file below the dump with x
    and y of each frame on a line. They say where the samples of a pixel are, from its centre, in
    pixels times `scale`, x right; `first` is the entry of the first frame, from 0 on.
    """

    jitter: str
    first: int = 0
    scale: float = 1.0
    y: Literal["down", "up"] = "down"

    @property
    def files(self) -> tuple[str, ...]:
        """The file of offsets, if there is one."""
        return () if self.jitter.strip().lower().startswith("halton ") else (self.jitter,)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A whole layout. Without `reference` nothing can be scored.

    `specular` and `emission` are added to radiance, and may be absent.
    `missing_motion` replaces absent motion: zero, or optical flow of albedo. `exposure` is a factor
    or "auto". `frames_per_second` may be any number above 0. `layer` is read where a channel's
    pattern matches several layers. Colours of other primaries become Rec. 709, unless
    `chromaticities` keeps them. `overscan` are pixels outside the display window.
    """

    radiance: Radiance
    reference: Reference = Reference(files=(), optional=True)
    specular: Radiance | None = None
    emission: Image | None = None
    albedo: Albedo | None = None
    normal: Normal | None = None
    depth: Depth | None = None
    motion: Motion | None = None
    camera: Camera | None = None
    missing_motion: Literal["zero", "flow"] = "zero"
    exposure: float | Literal["auto"] = "auto"
    frames_per_second: float = 24.0
    renderer: str = "unknown"
    layer: str = ""
    chromaticities: Literal["convert", "keep"] = "convert"
    overscan: Literal["cut", "keep"] = "cut"

    @property
    def images(self) -> dict[str, Image]:
        """The images that the layout names, by table."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, Image)}

    @property
    def moves_onward(self) -> bool:
        """True if motion points to the next frame, so that the frame before is read too."""
        return self.motion is not None and self.motion.points.endswith("next")

    @property
    def other_files(self) -> tuple[str, ...]:
        """Files below the dump that are not images."""
        cameras = (image.camera for image in (self.normal, self.motion) if image)
        offsets = self.camera.files if self.camera else ()
        return tuple(dict.fromkeys(name for name in (*cameras, *offsets) if name))


def ready_layouts() -> dict[str, Path]:
    """The files of the ready layouts, by name.

    >>> "blender" in ready_layouts()
    True
    """
    folder = Path(str(resources.files("rlbench.apps.dumps.importers") / "layouts"))
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}


def read_layout(name_or_file: str, names: Sequence[str] = ()) -> Layout:
    """A ready layout by its name, or one from a TOML file.

    Raises SourceError; the message lists `names`, by default those of the ready layouts.
    """
    ready = ready_layouts()
    path = ready.get(name_or_file, Path(name_or_file))
    if not path.is_file():
        names = names or list(ready)
        problem = f"no layout '{name_or_file}', and no such file; rlbench lint --guess writes one"
        raise SourceError(unknown_name(problem, name_or_file, sorted(names), "; there are"))
    try:
        document = read_toml(path)
    except (OSError, ValueError) as error:
        raise SourceError(str(error)) from error
    return decode_layout(document, path.name)


def decode_layout(document: Mapping[str, Any], file: str) -> Layout:
    """The layout in a TOML document.

    Raises SourceError, naming key, value and what is allowed.

    >>> radiance, reference = {"files": "{frame}.exr"}, {"files": "ref.{frame}.exr"}
    >>> motion = {"files": "mv.{frame}.exr", "unit": "pixel"}
    >>> tables = {"radiance": radiance, "reference": reference, "motion": motion}
    >>> decode_layout(tables, "engine.toml")
    Traceback (most recent call last):
    ...
    rlbench.errors.SourceError: engine.toml: [motion] unit is 'pixel', expected \
'pixels', 'ndc' or 'shares'. Did you mean 'pixels'?
    """
    _check_table(file, "", document, Layout)
    for name, kind in _tables(Layout).items():
        if name in document:
            if not isinstance(document[name], Mapping):
                raise SourceError(f"{file}: {name} is {document[name]!r}, expected a table")
            _check_table(file, f"[{name}] ", document[name], kind)
    try:
        return decode(document, Layout)
    except ValueError as error:
        raise SourceError(f"{file}: {error}") from error


def _check_table(file: str, label: str, table: Mapping[str, Any], kind: type) -> None:
    """Raise SourceError for an unknown key, an absent one, or a word that is not allowed."""
    fields = {field.name: field for field in dataclasses.fields(kind)}
    for key in table:
        if key not in fields:
            raise SourceError(
                unknown_name(
                    f"{file}: {label}has the unknown key '{key}'", key, fields, "; known keys"
                )
            )
    for key, field in fields.items():
        if field.default is dataclasses.MISSING and key not in table:
            raise SourceError(f"{file}: {label}needs the key '{key}'")
    for key, hint in typing.get_type_hints(kind).items():
        words = _allowed_words(hint)
        value = table.get(key)
        if words and key in table and not _is_allowed(value, hint, words):
            listed = " or ".join([", ".join(map(repr, words[:-1])), repr(words[-1])][-len(words) :])
            raise SourceError(
                f"{file}: {label}{key} is {value!r}, expected {listed}{suggest(str(value), words)}"
            )


def _tables(kind: type) -> dict[str, type]:
    """The dataclasses among a dataclass' fields, by name."""
    found = {}
    for name, hint in typing.get_type_hints(kind).items():
        for part in (hint, *typing.get_args(hint)):
            if dataclasses.is_dataclass(part) and isinstance(part, type):
                found[name] = part
    return found


def _allowed_words(hint: Any) -> list[str]:
    """The words of a Literal, on its own or in a union; none for other types."""
    if typing.get_origin(hint) is Literal:
        return list(typing.get_args(hint))
    return [word for part in typing.get_args(hint) for word in _allowed_words(part)]


def _is_allowed(value: Any, hint: Any, words: list[str]) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value in words or (float in typing.get_args(hint) and is_number)


def _as_tuple(words: Words) -> tuple[str, ...]:
    return (words,) if isinstance(words, str) else words

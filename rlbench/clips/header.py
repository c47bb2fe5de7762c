"""clip.toml, the header of a clip folder. It is written last: a folder without it is unfinished."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from rlbench.errors import RlbenchError
from rlbench.system.documents import decode, read_toml, write_toml

MAX_PIXELS = 2**26  # of an image: 8192 x 8192
MAX_NAME_BYTES = 200  # of a name in UTF-8, so that it fits into a file name
MAX_TEXT = 10_000  # characters of any other text
NAMES = ("name", "scene")  # may have parts, as in street/mini
TEXTS = ("preset", "sampler", "sampler_version", "licence", "device", "timed_with")
VERSION = 2  # of the format
FILE = "clip.toml"
MAX_FILE_BYTES = 2**24  # of clip.toml
MAX_JITTER = 2.0  # pixels, of the samples' offset
STANDARD_BUFFERS = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2}  # channels of each
OPTIONAL_BUFFERS = {  # channels of the buffers that only some clips have
    "object": 1,
    "albedo_first": 3,
    "normal_psr": 3,
    "depth_psr": 1,
    "object_psr": 1,
}
BUFFER_CHANNELS = STANDARD_BUFFERS | OPTIONAL_BUFFERS
LIMITATIONS = {  # what an imported clip may not have, although the format requires it
    "halves": "referenceA and referenceB are one image, so the noise of the reference is unknown",
    "independence": "samples share their seeds with other frames or with the reference",
    "linear": "radiance was converted from display values and is clipped to [0, 1], "
    "and so are the means of samples",
    "first motion": "motion of the first frame is zero, because the frame before it is unknown",
    **{
        name: f"{name} has another space, scale or range, or an unknown one"
        for name in BUFFER_CHANNELS
    },
    **{
        f"no {name}": f"the source has no {name}, so {name} is a constant without information"
        for name in STANDARD_BUFFERS
    },
    "no reference": "some frames or all have no reference, which is NaN in their files, so they "
    "have no scores",
    "reference jitter": "the reference is moved within the pixel as the samples are, so it shakes",
    "sky motion": "the source has no motion of the sky, so it points outside the image",
    "flow": "motion was estimated by optical flow of albedo, because the source has none",
}
NAMES_IN_DIGESTS = {
    "normal_psr": "normal_behind",
    "depth_psr": "depth_behind",
    "object_psr": "object_behind",
}


class Limits(NamedTuple):
    """The range of a number, ends included; for a list, the range of each of its numbers."""

    lowest: float
    highest: float
    allows_nan: bool = False  # nan: unknown

    def allow(self, value: float) -> bool:
        """Whether a value is in the range."""
        return self.lowest <= value <= self.highest or (self.allows_nan and math.isnan(value))

    def __str__(self) -> str:
        """The range for a message."""
        suffix = ", or nan for unknown" if self.allows_nan else ""
        return f"{self.lowest:.10g} to {self.highest:.10g}{suffix}"


LIMITS = {
    "height": Limits(1, 2**16),  # pixels
    "width": Limits(1, 2**16),  # pixels
    "frames": Limits(1, 100_000),
    "fps": Limits(1e-6, 1e6),
    "seed": Limits(0, 2**63 - 1),
    "exposure": Limits(1e-12, 1e12),
    "pool_spp": Limits(1, 1024),
    "radiance_cap": Limits(1e-12, math.inf),
    "reference_spp": Limits(0, 2**31 - 1),
    "noise_ceiling_db": Limits(-1000, 1000),
    "sample_ms": Limits(0, 1e12, allows_nan=True),
    "pools_ms": Limits(0, 1e12, allows_nan=True),
    "sample_p5_ms": Limits(0, 1e12),
    "sample_p95_ms": Limits(0, 1e12),
    "gbuffer_ms": Limits(0, 1e12),
}


class ClipError(RlbenchError, ValueError):
    """A clip folder that cannot be read or written."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """The fields of clip.toml, in the order of the file; the file begins with `version`.

    Radiance in the files is as traced: `exposure` is applied on reading.

    Attributes:
        name: name of the clip, unique within a benchmark; it seeds the sample order.
        scene: name of the scene; clips of one scene share their cost per sample.
        preset: preset of `rlbench render`, empty for other clips.
        sampler: what traced the samples, for example "mitsuba path".
        sampler_version: version of the sampler.
        height: rows of an image, pixels.
        width: columns of an image, pixels.
        frames: number of frames.
        fps: frames per second.
        seed: seed of the renderer.
        exposure: factor above 0 that maps radiance to 1.0 at display white.
        pool_spp: stored 1-spp images per frame in each pool.
        radiance_cap: largest value of a sample, in multiples of display white; inf for no cap.
        reference_spp: samples per pixel of both halves together, one number per frame; 0 for
            unknown.
        stratified: samples of a reference half follow a pattern, so it has less noise than
            independent samples would give.
        noise_ceiling_db: PSNR of the noise-free image against the reference in dB, one number per
            frame; may be empty.
        buffers: buffers of the G-buffer, keys of `BUFFER_CHANNELS`.
        pools: kinds of sample pool, for example "path".
        limitations: requirements of the format that the clip does not meet, keys of `LIMITATIONS`.
        missing_files: files of the scene that did not exist, so their shapes or textures are left
            out.
        static: neither camera nor objects move; such a clip has no motion buffer.
        jitter: offset of the samples of each frame from the centre of a pixel, pixels, x right, y
            down; empty where the camera is not jittered. Motion is without it.
        cuts: frames that begin a new shot, from 1 to `frames - 1`; all their motion points outside
            the image.
        light_changes: frames from which on the lights differ from those of the frame before, from 1
            to `frames - 1`.
        licence: licence of the images.
        sample_ms: time of one 1-spp trace of a full frame, milliseconds; nan for unknown.
        pools_ms: the same for each of `pools`; empty for a clip with one pool.
        device: machine that traced the samples.
        sample_p5_ms: 5th percentile of the repeated measurements of `sample_ms`; 0 for unknown.
        sample_p95_ms: their 95th percentile.
        gbuffer_ms: time of the four standard buffers of one frame, milliseconds; 0 for unknown.
        timed_with: tracer variant and threads of these times, as in "llvm_ad_rgb, 8 threads".

    Raises:
        ClipError: for values that are out of range or contradict each other.
    """

    name: str
    scene: str
    preset: str = ""
    sampler: str
    sampler_version: str = ""
    height: int
    width: int
    frames: int
    fps: float = 24.0
    seed: int = 0
    exposure: float = 1.0
    pool_spp: int = 8
    radiance_cap: float = math.inf
    reference_spp: tuple[int, ...]
    stratified: bool = False
    noise_ceiling_db: tuple[float, ...] = ()
    buffers: tuple[str, ...] = tuple(STANDARD_BUFFERS)
    pools: tuple[str, ...] = ("path",)
    limitations: tuple[str, ...] = ()
    missing_files: tuple[str, ...] = ()
    static: bool = False
    jitter: tuple[tuple[float, float], ...] = ()
    cuts: tuple[int, ...] = ()
    light_changes: tuple[int, ...] = ()
    licence: str = ""
    sample_ms: float = math.nan
    pools_ms: tuple[float, ...] = ()
    device: str = ""
    sample_p5_ms: float = 0.0
    sample_p95_ms: float = 0.0
    gbuffer_ms: float = 0.0
    timed_with: str = ""

    def __post_init__(self) -> None:
        """Raise ClipError for values that are out of range or contradict each other."""
        if violation := find_violation(self):
            raise ClipError(
                f"clip {describe_value(self.name)}: {violation}; correct {FILE}, or what writes it"
            )
        self._check_lengths()
        if not (self.buffers and self.pools):
            raise ClipError(f"clip '{self.name}': buffers and pools must each name at least one")
        self._check_words("buffers", BUFFER_CHANNELS)
        self._check_words("limitations", LIMITATIONS)
        self._check_events()

    def _check_lengths(self) -> None:
        expected = {
            "reference_spp": ("frames", {self.frames}),
            "noise_ceiling_db": ("frames", {0, self.frames}),
            "jitter": ("frames", {0, self.frames}),
            "pools_ms": ("pools", {0, len(self.pools)}),
        }
        for key, (items, counts) in expected.items():
            if (count := len(getattr(self, key))) not in counts:
                raise ClipError(
                    f"clip '{self.name}': {key} lists {count} {items}, the clip has {max(counts)}"
                )

    def _check_words(self, key: str, vocabulary: Iterable[str]) -> None:
        if unknown := sorted(set(getattr(self, key)) - set(vocabulary)):
            raise ClipError(
                f"clip '{self.name}': {key} lists {', '.join(unknown)}; "
                f"format version {VERSION} has: {', '.join(vocabulary)}"
            )

    def _check_events(self) -> None:
        if any(not abs(value) <= MAX_JITTER for offset in self.jitter for value in offset):
            raise ClipError(
                f"clip '{self.name}': jitter is outside -{MAX_JITTER:g} to {MAX_JITTER:g} pixels"
            )
        if self.cuts and (self.static or not set(self.cuts) <= set(range(1, self.frames))):
            raise ClipError(
                f"clip '{self.name}': cuts are {list(self.cuts)}; expected frames from 1 to "
                f"{self.frames - 1}, and none in a static clip"
            )
        if not set(self.light_changes) <= set(range(1, self.frames)):
            raise ClipError(
                f"clip '{self.name}': light_changes are {list(self.light_changes)}; expected "
                f"frames from 1 to {self.frames - 1}"
            )

    def sample_ms_of(self, pool: str) -> float:
        """Time of one full-frame sample per pixel from a pool, in milliseconds; nan if unknown."""
        times = dict(zip(self.pools, self.pools_ms or (self.sample_ms,), strict=False))
        return times.get(pool, math.nan)

    def first(self, frames: int | None) -> Header:
        """The header of a clip of the first `frames` frames, of all where there are no more."""
        if frames is None or frames >= self.frames:
            return self
        return replace(
            self,
            frames=frames,
            reference_spp=self.reference_spp[:frames],
            noise_ceiling_db=self.noise_ceiling_db[:frames],
            jitter=self.jitter[:frames],
            cuts=tuple(cut for cut in self.cuts if cut < frames),
            light_changes=tuple(change for change in self.light_changes if change < frames),
        )

    @property
    def tracer_of_times(self) -> str:
        """Tracer variant and threads of the times; in older clips those of `sampler` and `device`.

        Empty if another renderer than Mitsuba's path tracer took them.
        """
        variant = self.sampler_version.rpartition(" ")[2]
        if self.timed_with or not variant.endswith("_rgb"):
            return self.timed_with
        cores = re.search(r"(\d+) cores$", self.device)
        return f"{variant}, {cores[1]} threads" if cores else variant

    def digest_fields(self, pool: str) -> dict[str, Any]:
        """The fields that decide the tensors of a frame with samples from `pool`.

        They are part of the clip's digest, which therefore does not change when another pool is
        added. Keys and names are literals that must not change, or digests change.
        """
        keys = ("name", "scene", "height", "width", "frames", "exposure", "pool_spp")
        values = {"version": 1} | {key: getattr(self, key) for key in keys}
        values |= {"buffers": names_in_digests(self.buffers), "pools": (pool,)}
        values["static"] = self.static
        if self.limitations:
            values["lacks"] = names_in_digests(self.limitations)
        return values


def names_in_digests(names: Iterable[str]) -> tuple[str, ...]:
    """The names of buffers as hashes and keys of clips have them, which must not change.

    >>> names_in_digests(["depth", "depth_psr"])
    ('depth', 'depth_behind')
    """
    return tuple(NAMES_IN_DIGESTS.get(name, name) for name in names)


def write_header(folder: Path, header: Header) -> None:
    """Write clip.toml atomically. Call it last: it marks the clip as finished."""
    values = {field.name: getattr(header, field.name) for field in fields(Header)}
    if not header.missing_files:
        del values["missing_files"]  # only a scene by others may lack files
    if not header.jitter:
        del values["jitter"]  # only an engine's camera is jittered
    write_toml(folder / FILE, {"version": VERSION} | values)


def read_header(folder: Path) -> Header:
    """The header of a finished clip. Unknown keys are ignored.

    Raises ClipError where the folder or its clip.toml does not exist, or the file is not valid.
    """
    if not folder.is_dir():
        raise ClipError(f"no clip folder {folder}; {_list_clips(folder.parent)}")
    path = folder / FILE
    if not path.is_file():
        raise ClipError(
            f"clip {folder} is unfinished: it has no {FILE}. "
            "Resume it with `rlbench render` or `rlbench import`"
        )
    try:
        if (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise ValueError(f"it has {size} bytes, at most {MAX_FILE_BYTES} are read")
        document = read_toml(path)
    except (OSError, ValueError, RecursionError) as error:
        raise ClipError(
            f"{path} cannot be read ({error}); delete the file and render the clip again"
        ) from error
    version = document.get("version")
    if version != VERSION:
        raise ClipError(
            f"{path} has format version {describe_value(version)}, this rlbench reads {VERSION}: "
            "update rlbench, or render the clip again"
        )
    return _decode_header(path, document)


def _decode_header(path: Path, document: Mapping[str, Any]) -> Header:
    """The header in a document. Raises ClipError, naming the wrong key."""
    try:
        return decode(document, Header)
    except (ValueError, OverflowError) as error:
        if isinstance(error.__cause__, ClipError):  # raised by Header itself
            raise error.__cause__ from None
        key = re.search(r"\$\.(\w+)", str(error))  # msgspec names a key as `$.height`
        value = f", which is {describe_value(document.get(key[1]))}" if key else ""
        raise ClipError(
            f"{path}: {error}{value}; correct the file, or render the clip again"
        ) from error


def _list_clips(parent: Path) -> str:
    """The clips in a folder, for a message about a mistyped name."""
    if not parent.is_dir():
        return f"the folder {parent} does not exist either"
    names = sorted(path.parent.name for path in parent.glob(f"*/{FILE}"))
    return f"clips in {parent}: {', '.join(names) or 'none'}"


def find_violation(fields: Any) -> str | None:
    """The first field outside its limits, what it is and what it must be; None if there is none."""
    for key, limits in LIMITS.items():
        value = getattr(fields, key)
        for number in value if isinstance(value, tuple) else (value,):
            if not limits.allow(number):
                listed = "lists" if isinstance(value, tuple) else "is"
                return f"{key} {listed} {describe_value(number)}, expected {limits}"
    if (pixels := fields.height * fields.width) > MAX_PIXELS:
        return f"height x width is {pixels} pixels, expected at most {MAX_PIXELS}"
    return _find_unsafe_text(fields)


def _find_unsafe_text(fields: Any) -> str | None:
    parts = [(key, part) for key in NAMES for part in getattr(fields, key).split("/")]
    for key, name in [*parts, *(("pools", pool) for pool in fields.pools)]:
        if not is_plain_name(name) or (key == "pools" and " " in name):
            return (
                f"{key} has {describe_value(name)}, expected letters, digits and . _ + - @ alone, "
                f"in at most {MAX_NAME_BYTES} bytes"
            )
    for key in (*NAMES, *TEXTS):
        most = MAX_NAME_BYTES if key in NAMES else MAX_TEXT
        if (length := len(getattr(fields, key).encode(errors="replace"))) > most:
            return f"{key} has {length} bytes, expected at most {most}"
    return _find_duplicate("buffers", fields.buffers) or _find_duplicate("pools", fields.pools)


def is_plain_name(name: str) -> bool:
    """Whether a name is safe as a file name: no folder, no control character, not only dots.

    >>> is_plain_name("hall-cut"), is_plain_name("../hall"), is_plain_name("..")
    (True, False, False)
    """
    is_short = len(name.encode(errors="replace")) <= MAX_NAME_BYTES
    return is_short and bool(re.fullmatch(r"[\w .+@-]+", name) and name.strip(". "))


def describe_value(value: Any) -> str:
    """A value for a message, shortened to 80 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python converts no integer of more than 4300 digits
        return "an integer of more than 4300 digits"
    return text if len(text) <= 80 else f"{text[:77]}..."


def _find_duplicate(key: str, words: Sequence[str]) -> str | None:
    twice = sorted({word for word in words if words.count(word) > 1})
    return f"{key} lists {', '.join(twice)} twice" if twice else None

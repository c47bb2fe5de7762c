"""clip.toml: what a clip folder says of itself; written last, so without it it is unfinished."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from rlbench.errors import RlbenchError
from rlbench.system.paths import replacing

VERSION = 1
FILE = "clip.toml"
CORE = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2}  # channels of each view buffer
EXTRAS = {  # of those that a clip has only where they were asked for
    "object": 1,
    "albedo_first": 3,
    "normal_behind": 3,
    "depth_behind": 1,
    "object_behind": 1,
}
VIEWS = CORE | EXTRAS
LACKS = {  # what a clip that others rendered may not have, though the format asks for it
    "halves": "referenceA and referenceB are one image, so its noise cannot be told from error",
    "independence": "seeds of samples are those of other frames or of the reference",
    "linear": "radiance is light of a display, clipped to [0, 1], and so are the samples' means",
    "first motion": "motion of the first frame is zero, as no frame is known before it",
    **{name: f"{name} is of another space, scale or range, or not known to be" for name in VIEWS},
}


class ClipError(RlbenchError, ValueError):
    """A clip folder that cannot be read or written as asked."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """All that clip.toml holds, in its order. Radiance in the files is as traced, not exposed."""

    version: int = VERSION  # of this format
    name: str  # unique within a benchmark; decides, with the seed, the order of sale
    scene: str  # clips of one scene share their cost per sample
    preset: str = ""  # of the renderer, for the reader
    sampler: str  # what traced the samples, e.g. "mitsuba path"
    sampler_version: str = ""
    height: int  # pixels
    width: int  # pixels
    frames: int
    fps: float = 24.0  # frames per second
    seed: int = 0  # of the renderer
    exposure: float = 1.0  # radiance times this is 1.0 at display white
    pool_spp: int = 8  # stored 1-spp images per frame, in each pool
    radiance_cap: float = math.inf  # of every sample, times display white; inf where there is none
    reference_spp: tuple[int, ...]  # per frame, of both halves together; 0: unknown
    stratified: bool = False  # samples of a half follow a pattern: less noise than independent ones
    noise_ceiling_db: tuple[float, ...] = ()  # per frame, PSNR of the truth against the reference
    buffers: tuple[str, ...] = tuple(CORE)  # of the view
    pools: tuple[str, ...] = ("path",)
    lacks: tuple[str, ...] = ()  # of what the format asks for; words of LACKS
    static: bool = False  # neither camera nor objects move; then there is no motion buffer
    cuts: tuple[int, ...] = ()  # frames where another shot begins; all motion leads outside there
    licence: str = ""  # of the pixels
    sample_ms: float = math.nan  # time of one full-frame 1-spp trace, or nan
    pools_ms: tuple[float, ...] = ()  # the same of each pool, where there are several
    device: str = ""  # where it was traced

    def __post_init__(self) -> None:
        """Raise ClipError for values that contradict each other."""
        low = [k for k in ("height", "width", "frames", "pool_spp") if getattr(self, k) < 1]
        if low:
            raise ClipError(f"clip '{self.name}': {', '.join(low)} must be at least 1")
        if not (math.isfinite(self.exposure) and self.exposure > 0):
            raise ClipError(f"clip '{self.name}': exposure is {self.exposure}, must be above 0")
        for key in ("reference_spp", "noise_ceiling_db"):
            told = getattr(self, key)
            if len(told) != self.frames and (told or key == "reference_spp"):
                raise ClipError(
                    f"clip '{self.name}': {key} lists {len(told)} frames, "
                    f"the clip has {self.frames}"
                )
        if not (self.buffers and self.pools):
            raise ClipError(f"clip '{self.name}': buffers and pools must each name at least one")
        if unknown := sorted(set(self.buffers) - set(VIEWS)):
            raise ClipError(
                f"clip '{self.name}': unknown view buffer {', '.join(unknown)}; "
                f"format v{VERSION} knows {', '.join(VIEWS)}"
            )
        if unknown := sorted(set(self.lacks) - set(LACKS)):
            raise ClipError(
                f"clip '{self.name}': lacks {', '.join(unknown)}; known are {', '.join(LACKS)}"
            )
        self._check_cuts()

    def _check_cuts(self) -> None:
        if self.cuts and (self.static or not set(self.cuts) <= set(range(1, self.frames))):
            raise ClipError(
                f"clip '{self.name}': cuts are {list(self.cuts)}; expected frames from 1 to "
                f"{self.frames - 1}, of a clip that is not static"
            )

    def sample_ms_of(self, pool: str) -> float:
        """Time of one full-frame sample per pixel of a pool, in milliseconds; nan if unknown."""
        known = dict(zip(self.pools, self.pools_ms or (self.sample_ms,), strict=False))
        return known.get(pool, math.nan)

    def pixels(self, pool: str) -> dict[str, Any]:
        """The fields on which a frame's tensors depend, with the samples of one pool.

        What a content hash must cover: that of one pool stays as it is when another is added.
        """
        kept = ("version", "name", "scene", "height", "width", "frames", "exposure", "pool_spp")
        lacks = ("lacks",) if self.lacks else ()  # as it was, where nothing is lacking
        held = {k: getattr(self, k) for k in (*kept, "buffers", "pools", "static", *lacks)}
        return held | {"pools": (pool,)}


def write_header(folder: Path, header: Header) -> None:
    """Write clip.toml, whole or not at all. Call it last: it says that the clip is finished."""
    lines = [f"{f.name} = {_toml(getattr(header, f.name))}\n" for f in fields(Header)]
    with replacing(folder / FILE) as path:
        path.write_text("".join(lines), encoding="utf-8")


def read_header(folder: Path) -> Header:
    """The header of a finished clip. Keys that the format does not know are the renderer's own.

    Raises ClipError where there is no folder, no clip.toml, or one that cannot be understood.
    """
    if not folder.is_dir():
        raise ClipError(f"no clip folder {folder}; {_there_is(folder.parent)}")
    path = folder / FILE
    if not path.is_file():
        raise ClipError(
            f"clip {folder} is unfinished, it has no {FILE}: "
            "`rlbench render`, or `rlbench import`, resumes it"
        )
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ClipError(
            f"{path} is not TOML ({error}); delete it and render the clip again"
        ) from error
    if (version := found.get("version")) != VERSION:
        raise ClipError(
            f"{path} has format version {version}, this rlbench reads {VERSION}: "
            "update rlbench, or render the clip again"
        )
    return Header(
        **{f.name: _field(path, f.name, found) for f in fields(Header) if _given(f, found)}
    )


def _given(field: Any, found: Mapping[str, Any]) -> bool:
    return field.name in found or field.default is MISSING


def _field(path: Path, name: str, found: Mapping[str, Any]) -> Any:
    """The value of one key as the type that Header declares."""
    if name not in found:
        raise ClipError(f"{path} has no '{name}', which format v{VERSION} requires")
    value, kind = found[name], str(Header.__annotations__[name])
    if kind == "float" and type(value) is int:
        return float(value)
    if kind.startswith("tuple"):
        item = kind.removeprefix("tuple[").removesuffix(", ...]")
        if isinstance(value, list) and all(type(v).__name__ == item for v in value):
            return tuple(value)
    elif type(value).__name__ == kind:
        return value
    raise ClipError(f"{path}: '{name}' is {value!r}, expected {kind}")


def _there_is(parent: Path) -> str:
    """What a person who mistyped a clip's name would want to read."""
    if not parent.is_dir():
        return f"there is no folder {parent} either"
    there = sorted(path.parent.name for path in parent.glob(f"*/{FILE}"))
    return f"there is: {', '.join(there)}" if there else f"there is no clip in {parent}"


def _toml(value: Any) -> str:
    """One value in TOML's syntax."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(float(value)) if isinstance(value, float) else str(int(value))

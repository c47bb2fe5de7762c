"""Cost profiles: published times of a renderer, and of methods, on a named machine."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from rlbench.errors import RlbenchError
from rlbench.registry.near_names import suggest
from rlbench.system import documents

__all__ = ["MEASURED", "CostError", "CostProfile", "ProfileTime", "profile", "profiles"]

MEASURED = "measured"  # the name of no profile: times of this machine
PROFILES = Path(__file__).parent / "profiles"
TABLES = ("scene_ms", "inference_ms")
PAGE = "docs/how-to/charge-your-renderer.md has one to copy"


class CostError(RlbenchError, ValueError):
    """A cost profile that does not exist or cannot be used."""


class ProfileTime(NamedTuple):
    """A time from a profile and where it comes from."""

    ms: float
    convention: str
    note: str = ""


@dataclass(frozen=True)
class CostProfile:
    """Times on a named machine: of a full frame at 1 sample per pixel by scene, and of methods.

    `inference_ms` is optional. Without it, inference is measured here, on another device than the
    samples.
    """

    title: str
    source: str
    device: str
    height: int  # pixels
    width: int  # pixels
    default_ms: float  # for scenes that are not in scene_ms
    scene_ms: Mapping[str, float]
    inference_ms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # by size, as in "720x720" (width x height), and method

    def sample(self, scene: str, height: int, width: int) -> ProfileTime:
        """The scene's published time, scaled linearly in pixels from the profile's size.

        >>> profile("paper-2080ti").sample("city", 360, 720).ms
        17.25
        """
        share = height * width / (self.height * self.width)
        note = "" if scene in self.scene_ms else f"the profile's default, as it has no '{scene}'"
        ms = self.scene_ms.get(scene, self.default_ms) * share
        return ProfileTime(ms, self._convention(f"{self.width}x{self.height}"), note)

    def inference(self, method: str, height: int, width: int) -> ProfileTime | None:
        """The method's published inference time, or None; scaled from the nearest size it has.

        >>> profile("paper-2080ti").inference("ours/latent", 360, 720).ms
        11.25
        """
        times = {
            size: by_method[method]
            for size, by_method in self.inference_ms.items()
            if method in by_method
        }
        if not times:
            return None
        pixels = height * width
        size = min(times, key=lambda size: abs(math.log(_pixels(size) / pixels)))
        return ProfileTime(times[size] * pixels / _pixels(size), self._convention(size))

    def _convention(self, size: str) -> str:
        return f"{self.device}, {self.source}, scaled by pixels from {size}"


def profiles() -> list[str]:
    """Names of the profiles that ship.

    >>> profiles()
    ['paper-2080ti']
    """
    return sorted(file.stem for file in PROFILES.glob("*.toml"))


def profile(name: str) -> CostProfile:
    """A cost profile by name, or by the path of a TOML file. Raises CostError."""
    file = PROFILES / f"{name}.toml" if name in profiles() else Path(name)
    if not file.is_file():
        names = [MEASURED, *profiles()]
        raise CostError(
            f"no cost profile '{name}'. Use {', '.join(names)}, or the path of a TOML file"
            f"{suggest(name, names)}"
        )
    try:
        document = documents.read_toml(file)
        _check(name, document)
        return documents.decode(document, CostProfile)
    except CostError:
        raise
    except ValueError as error:
        raise CostError(f"cost profile '{name}' cannot be read: {error}. {PAGE}") from error


def _check(name: str, document: Mapping[str, Any]) -> None:
    """Raise CostError for missing and unknown keys, and for numbers that are no times or sizes."""
    required = [each.name for each in fields(CostProfile) if each.default_factory is MISSING]
    missing = [key for key in required if key not in document]
    unknown = documents.unknown_keys(document, CostProfile)
    if missing or unknown:
        faults = {"missing": missing, "unknown": unknown}
        keys = "; ".join(f"{what}: {', '.join(keys)}" for what, keys in faults.items() if keys)
        raise CostError(f"cost profile '{name}' cannot be read: {keys}. {PAGE}")
    bad = [key for key, time in _times(document) if not _is_at_least(0, time)]
    bad += [key for key in ("height", "width") if not _is_at_least(1, document.get(key, 1))]
    if bad:
        raise CostError(
            f"cost profile '{name}': {', '.join(bad)} must be numbers, a time at least 0, a side "
            "at least 1; scene_ms is a table of times by scene, inference_ms has such a table by "
            "method for each size, as in [inference_ms.720x720]"
        )


def _times(document: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Every time of a profile with its key; a table that is none, or a bad size, is not a time."""
    yield "default_ms", document.get("default_ms", 0)
    for table in TABLES:
        times = document.get(table, {})
        if not isinstance(times, Mapping):
            yield table, math.nan
        elif table == "scene_ms":
            yield from times.items()
        else:
            for size, by_method in times.items():
                is_table = isinstance(by_method, Mapping) and _pixels(size) > 0
                yield from by_method.items() if is_table else [(f"{table}.{size}", math.nan)]


def _pixels(size: str) -> int:
    """Pixels of a size such as "720x480"; 0 if it is none."""
    width, _, height = size.partition("x")
    return int(width) * int(height) if width.isdecimal() and height.isdecimal() else 0


def _is_at_least(minimum: float, value: object) -> bool:
    """Is it a finite number of at least `minimum`?"""
    return isinstance(value, int | float) and minimum <= value < math.inf

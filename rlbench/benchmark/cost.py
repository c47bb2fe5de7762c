"""The cost of a sample: time of one sample per pixel of a scene, measured or published.

`measured` is the time in the clip's header if the clip was rendered on this machine, else the time
of this machine's own path tracer, measured once and cached. Any other name is a cost profile: one
that ships, such as `paper-2080ti`, or the path of a TOML file like it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench import registry
from rlbench.errors import RlbenchError
from rlbench.system import code_hash, documents, paths

if TYPE_CHECKING:
    from rlbench.clips.stored import Header

__all__ = ["MEASURED", "Cost", "CostError", "CostProfile", "measured", "profile", "profiles"]

MEASURED = "measured"
PROFILES = Path(__file__).parent / "profiles"


class CostError(RlbenchError, ValueError):
    """A cost profile that does not exist or cannot be used."""


@dataclass(frozen=True)
class Cost:
    """Time of one sample per pixel, and how it was obtained.

    `convention` is the same for all scenes that are measured alike: reports refuse to compare
    times with different conventions.
    """

    sample_ms: float  # nan where it is not known
    convention: str
    note: str = ""  # why it is not known, or a remark on it


@dataclass(frozen=True)
class CostProfile:
    """Time of a full frame at 1 sample per pixel on a named machine, by scene."""

    title: str
    source: str
    device: str
    height: int  # pixels
    width: int  # pixels
    default_ms: float  # for scenes that are not in scene_ms
    scene_ms: Mapping[str, float]

    def cost(self, scene: str, height: int, width: int) -> Cost:
        """The scene's published time, scaled linearly in pixels from the profile's size.

        >>> profile("paper-2080ti").cost("city", 360, 720).sample_ms
        17.25
        """
        share = height * width / (self.height * self.width)
        size = f"{self.width}x{self.height}"
        convention = f"{self.device}, {self.source}, scaled by pixels from {size}"
        note = "" if scene in self.scene_ms else f"the profile's default, as it has no '{scene}'"
        return Cost(self.scene_ms.get(scene, self.default_ms) * share, convention, note)


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
        names = ", ".join([MEASURED, *profiles()])
        raise CostError(f"no cost profile '{name}'. Use {names}, or the path of a TOML file")
    try:
        document = documents.read_toml(file)
        _check(name, document)
        return documents.decode(document, CostProfile)
    except CostError:
        raise
    except ValueError as error:
        raise CostError(
            f"cost profile '{name}' cannot be read: {error}. "
            "docs/how-to/charge-your-renderer.md has one to copy"
        ) from error


def _check(name: str, document: Mapping[str, Any]) -> None:
    """Raise CostError for unknown keys, and for numbers that are no times or sizes."""
    if unknown := documents.unknown_keys(document, CostProfile):
        raise CostError(
            f"cost profile '{name}' cannot be read: unknown keys {', '.join(unknown)}. Remove them"
        )
    scenes = document.get("scene_ms", {})
    times = scenes if isinstance(scenes, Mapping) else {"scene_ms": math.nan}
    times = {"default_ms": document.get("default_ms", 0), **times}
    bad = [key for key, time in times.items() if not _is_at_least(0, time)]
    bad += [key for key in ("height", "width") if not _is_at_least(1, document.get(key, 1))]
    if bad:
        raise CostError(
            f"cost profile '{name}': {', '.join(bad)} must be numbers, a time at least 0, a side "
            "at least 1; scene_ms is a table of times by scene"
        )


def _is_at_least(minimum: float, value: object) -> bool:
    """Is it a finite number of at least `minimum`?"""
    return isinstance(value, int | float) and minimum <= value < math.inf


def published(profile: CostProfile, header: Header, pool: str) -> Cost:
    """Cost of a path sample by a profile; of another pool, scaled by its measured relative cost.

    The relative cost is that of the clip's renderer. Without it the cost is not known.
    """
    path = profile.cost(header.scene, header.height, header.width)
    if pool == "path":
        return path
    relative = header.sample_ms_of(pool) / header.sample_ms_of("path")
    if not math.isfinite(relative):
        reason = (
            f"the profile has path samples only, and the clip has no sample time of its {pool} pool"
        )
        return Cost(math.nan, path.convention, reason)
    note = f"a {pool} sample is {relative:.3g} path samples, as measured on '{header.device}'"
    return Cost(path.sample_ms * relative, path.convention, note)


def measured(header: Header, machine: str, pool: str = "path") -> Cost:
    """Cost in the clip's header if it was rendered on `machine`, else by this machine's tracer.

    The tracer runs once for each scene, size and code; the cache keeps the time.
    """
    convention, known_ms = f"path tracer, measured on {machine}", header.sample_ms_of(pool)
    note = "" if pool == "path" else f"a sample of the {pool} pool, with all of its shadow rays"
    if header.device == machine and math.isfinite(known_ms):
        return Cost(known_ms, convention, note)
    file = paths.cache_folder() / "sample_ms.json"
    times = json.loads(file.read_text()) if file.is_file() else {}
    key = f"{header.scene} {header.width}x{header.height} {machine} {_code(header.scene)}"
    key += f" {pool}" * (pool != "path")
    if key not in times:
        try:
            times[key] = _trace(header, pool)
        except Exception as error:  # a missing scene or tracer is a reason, it does not stop a run
            reason = (
                f"rendered on '{header.device}', not here, and cannot be traced here: "
                f"{type(error).__name__}: {error}"
            )
            return Cost(math.nan, convention, reason)
        with paths.atomic_write(file) as temporary:
            temporary.write_text(json.dumps(times, indent=1))
    return Cost(times[key], convention, note)


def _code(scene: str) -> str:
    """Hash of the code of a scene and of the tracer; empty without such a scene."""
    entry = registry.list_entries("scenes").get(scene)
    if entry is None:
        return ""
    modules = code_hash.import_closure(entry.target.partition(":")[0])
    return code_hash.code_hash(modules, core=["rlbench.render"])


def _trace(header: Header, pool: str) -> float:
    """Milliseconds of one sample per pixel of the scene, traced now."""
    scene = registry.load_plugin("scenes", header.scene)()
    from rlbench.render.jobs.extra_pools import pool_sample_ms
    from rlbench.render.mitsuba.open_tracer import sample_ms

    if pool != "path":
        return float(pool_sample_ms(scene, header.height, header.width, pool))
    return float(sample_ms(scene, header.height, header.width))

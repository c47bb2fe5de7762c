"""What a sample costs: the time of one sample per pixel of a scene, measured or published.

`measured` is the time that the clip's renderer wrote down, if it was this machine, and else that of
this machine's own path tracer, traced now and remembered in the cache. Any other name is a profile:
one that is shipped, such as `paper-2080ti`, or a TOML file like those.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path

from rlbench import registry
from rlbench.clips.stored import Header
from rlbench.errors import RlbenchError
from rlbench.system import code_hash, paths

MEASURED = "measured"


class CostError(RlbenchError, ValueError):
    """A cost profile that is not there or cannot be used."""


@dataclass(frozen=True)
class Cost:
    """Time of one sample per pixel, and how it came about.

    `convention` is the same for all scenes that are measured alike, for reports refuse to compare
    times that are not.
    """

    sample_ms: float  # nan where it is not known
    convention: str
    note: str = ""  # why it is not known, or what to know of it


@dataclass(frozen=True)
class CostProfile:
    """What a full frame at 1 sample per pixel takes on a named machine, by scene."""

    title: str
    source: str
    device: str
    height: int
    width: int
    default_ms: float  # for scenes that are not named
    scene_ms: Mapping[str, float]

    def cost(self, scene: str, height: int, width: int) -> Cost:
        """The scene's published time, scaled linearly in pixels from the profile's size."""
        share = height * width / (self.height * self.width)
        told = f"{self.device}, {self.source}, scaled by pixels from {self.width}x{self.height}"
        note = "" if scene in self.scene_ms else f"the profile's default, as it has no '{scene}'"
        return Cost(self.scene_ms.get(scene, self.default_ms) * share, told, note)


def profiles() -> list[str]:
    """Names of the profiles that are shipped."""
    there = (files("rlbench.benchmark") / "profiles").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in there if file.name.endswith(".toml"))


def profile(name: str) -> CostProfile:
    """A profile by name, or by the path of a TOML file. Raises CostError."""
    shipped = name in profiles()
    place = files("rlbench.benchmark") / "profiles" / f"{name}.toml" if shipped else Path(name)
    if not place.is_file():
        have = ", ".join([MEASURED, *profiles()])
        raise CostError(f"no cost profile '{name}'; there are: {have}, or the path of a TOML file")
    try:
        told = tomllib.loads(place.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CostError(f"cost profile '{name}' cannot be read: {error}") from error
    wanted = {field.name for field in fields(CostProfile)}
    if wrong := sorted(wanted ^ told.keys()):
        raise CostError(
            f"cost profile '{name}' cannot be read: {', '.join(wrong)} are missing or too many of "
            f"{', '.join(sorted(wanted))}; docs/cost.md has one to copy"
        )
    read = CostProfile(**told)
    sides = {"height": read.height, "width": read.width}
    given = read.scene_ms if isinstance(read.scene_ms, Mapping) else {"scene_ms": None}
    times = {"default_ms": read.default_ms, **given}
    bad = [key for key, time in times.items() if not _at_least(0, time)]
    if bad := [*bad, *(key for key, side in sides.items() if not _at_least(1, side))]:
        raise CostError(
            f"cost profile '{name}': {', '.join(bad)} must be numbers, a time at least 0, a side "
            "at least 1; scene_ms is a table of times by scene"
        )
    return read


def _at_least(least: float, value: object) -> bool:
    """Is it a finite number of at least so much?"""
    return isinstance(value, int | float) and least <= value < math.inf


def published(profile: CostProfile, header: Header, pool: str) -> Cost:
    """What a profile says of a clip's path tracer, and of another pool as many times that as here.

    As many times, that is, as the clip's renderer has measured; without that it is not known.
    """
    found = profile.cost(header.scene, header.height, header.width)
    if pool == "path":
        return found
    dearer = header.sample_ms_of(pool) / header.sample_ms_of("path")
    if not math.isfinite(dearer):
        why = f"the profile knows path samples alone, and the clip no cost of its {pool} pool"
        return Cost(math.nan, found.convention, why)
    told = f"a {pool} sample is {dearer:.3g} path samples, as measured on '{header.device}'"
    return Cost(found.sample_ms * dearer, found.convention, told)


def measured(header: Header, here: str, pool: str = "path") -> Cost:
    """What the clip's renderer wrote if it was `here`, else what this machine's tracer takes.

    The tracer is asked once for each scene, size and code, and its answer kept in the cache.
    """
    convention, known_ms = f"path tracer, measured on {here}", header.sample_ms_of(pool)
    told = "" if pool == "path" else f"a sample of the {pool} pool, with all of its shadow rays"
    if header.device == here and math.isfinite(known_ms):
        return Cost(known_ms, convention, told)
    file = paths.cache() / "sample_ms.json"
    known = json.loads(file.read_text()) if file.is_file() else {}
    key = f"{header.scene} {header.width}x{header.height} {here} {_code(header.scene)}"
    key += f" {pool}" * (pool != "path")
    if key not in known:
        try:
            known[key] = _trace(header, pool)
        except Exception as error:  # a scene or a tracer that is not there is a reason, not an end
            why = f"{type(error).__name__}: {error}"
            note = f"rendered on '{header.device}', not here, and not traceable here: {why}"
            return Cost(math.nan, convention, note)
        with paths.replacing(file) as temporary:
            temporary.write_text(json.dumps(known, indent=1))
    return Cost(known[key], convention, told)


def _code(scene: str) -> str:
    """Hash of the code of a scene and of the tracer; empty where there is no such scene."""
    found = registry.entries("scenes").get(scene)
    if found is None:
        return ""
    modules = code_hash.import_closure(found.target.partition(":")[0])
    return code_hash.code_hash(modules, core=["rlbench.render"])


def _trace(header: Header, pool: str) -> float:
    """Milliseconds of one sample per pixel of the scene, traced now."""
    scene = registry.load("scenes", header.scene)()
    from rlbench.render.jobs.extra_pools import trace_ms
    from rlbench.render.mitsuba.open_tracer import sample_ms

    if pool != "path":
        return float(trace_ms(scene, header.height, header.width, pool))
    return float(sample_ms(scene, header.height, header.width))

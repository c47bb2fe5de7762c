"""The cost of a frame's samples and of its G-buffer, measured or published.

`measured` is the time in the clip's header if the clip was rendered on this machine, else the time
of this machine's own path tracer, measured once and cached. Any other name is a cost profile
(`cost_profile`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from rlbench import registry
from rlbench.benchmark.cost_profile import MEASURED, CostError, CostProfile, profile, profiles
from rlbench.benchmark.results import UNRELIABLE
from rlbench.system import code_hash, paths, provenance

if TYPE_CHECKING:
    from rlbench.clips.stored import Header

__all__ = [
    "FULL_FRAME",
    "MEASURED",
    "Cost",
    "CostError",
    "CostProfile",
    "Scatter",
    "measured",
    "profile",
    "profiles",
    "published",
    "tracing",
    "with_gbuffer",
]

MAX_SPREAD = 1.25  # p95 / p5 of the time of a sample; beyond it the machine was busy


class Scatter(NamedTuple):
    """A factor on the time of a sample, for counts that leave holes."""

    factor: float
    note: str = ""  # why it is 1 although the counts are adaptive


FULL_FRAME = Scatter(1.0)


@dataclass(frozen=True)
class Cost:
    """Time of one sample per pixel and of a G-buffer, and how they were obtained.

    `convention` is the same for all scenes that are measured alike: reports refuse to compare
    times with different conventions.
    """

    sample_ms: float  # nan where it is not known
    convention: str
    note: str = ""  # why it is not known, or a remark on it
    device: str = ""  # that traces the samples
    gbuffer_ms: float = 0.0  # 0 for a method that reads none, and where it is not known
    gbuffer_convention: str = "the method reads no G-buffer"
    scatter: Scatter = FULL_FRAME  # what samples at adaptive counts cost more


def published(profile: CostProfile, header: Header, pool: str) -> Cost:
    """Cost of a path sample by a profile; of another pool, scaled by its measured relative cost.

    The relative cost is that of the clip's renderer. Without it the cost is not known.
    """
    path = profile.sample(header.scene, header.height, header.width)
    if pool == "path":
        return Cost(*path, device=profile.device)
    relative = header.sample_ms_of(pool) / header.sample_ms_of("path")
    if not math.isfinite(relative):
        reason = (
            f"the profile has path samples only, and the clip has no sample time of its {pool} pool"
        )
        return Cost(math.nan, path.convention, reason, profile.device)
    note = f"a {pool} sample is {relative:.3g} path samples, as measured on '{header.device}'"
    return Cost(path.ms * relative, path.convention, note, profile.device)


def measured(header: Header, machine: str, pool: str = "path") -> Cost:
    """Cost in the clip's header if it was rendered on `machine`, else by this machine's tracer.

    The tracer runs once for each scene, size, tracer variant, number of threads and code; the
    cache keeps the time.
    """
    convention, known_ms = f"path tracer, measured on {machine}", header.sample_ms_of(pool)
    note = "" if pool == "path" else f"a sample of the {pool} pool, with all of its shadow rays"
    if header.device == machine and math.isfinite(known_ms):
        tracer = header.tracer_of_times
        convention += f", {tracer}" * bool(tracer)
        return Cost(known_ms, convention, _spread_reason(header) or note, _device(tracer, machine))
    if header.scene not in registry.list_entries("scenes"):
        reason = (
            f"rendered on '{header.device}', not here, and '{header.scene}' is not a scene that "
            "can be traced here; give your renderer's time: --cost mine.toml "
            "(docs/how-to/charge-your-renderer.md)"
        )
        return Cost(math.nan, convention, reason, machine)
    try:
        sample_ms, tracer = _traced_here(header, machine, pool)
    except Exception as error:  # a missing scene or tracer is a reason, it does not stop a run
        reason = (
            f"rendered on '{header.device}', not here, and cannot be traced here: "
            f"{type(error).__name__}: {error}"
        )
        return Cost(math.nan, convention, reason, machine)
    return Cost(sample_ms, f"{convention}, {tracer}", note, _device(tracer, machine))


def tracing(header: Header, machine: str, pool: str) -> str:
    """The tracer and the code by which `measured` times a sample here, for the identity of a cell.

    Empty where it takes the time in the clip's header, and where the scene is not installed. Where
    there is no tracer, the type of its error.
    """
    is_known = header.device == machine and math.isfinite(header.sample_ms_of(pool))
    if is_known or header.scene not in registry.list_entries("scenes"):
        return ""
    try:
        from rlbench.render.mitsuba.open_tracer import describe_tracer

        return f"{describe_tracer()} {_code(header.scene)}"
    except Exception as error:  # `measured` gives the reason in its note
        return type(error).__name__


def with_gbuffer(cost: Cost, path_ms: float, header: Header) -> Cost:
    """`cost` with the time of the clip's G-buffer, relative to `path_ms` as its renderer found it.

    A renderer traces a G-buffer once per frame, whatever is sampled. Where the clip does not have
    its time, it is charged as 0.
    """
    if not (header.gbuffer_ms > 0 and header.sample_ms > 0):
        unknown = (
            "not known, charged as 0: rlbench render --remeasure-sample-time measures it for "
            "presets"
        )
        return replace(cost, gbuffer_convention=unknown)
    relative = header.gbuffer_ms / header.sample_ms
    convention = f"{relative:.3g} path samples, as measured on '{header.device}'"
    known = path_ms * relative
    return replace(
        cost,
        gbuffer_ms=known if math.isfinite(known) else 0.0,
        gbuffer_convention=convention,
    )


def _device(tracer: str, machine: str) -> str:
    """The device on which this machine's tracer runs."""
    return provenance.machine().gpu if tracer.startswith("cuda") else machine


def _spread_reason(header: Header) -> str:
    """Why the time of a sample in a header must not be believed; empty if it may."""
    if header.sample_p95_ms <= MAX_SPREAD * header.sample_p5_ms:  # both are 0 in older clips
        return ""
    return (
        f"{UNRELIABLE} a sample took {header.sample_p5_ms:.3g} to {header.sample_p95_ms:.3g} ms "
        "(p5 to p95) when the clip was rendered; measure it again with rlbench render "
        "--remeasure-sample-time"
    )


def _traced_here(header: Header, machine: str, pool: str) -> tuple[float, str]:
    """Milliseconds of a sample by this machine's tracer, from the cache or now, and the tracer."""
    scene = registry.load_plugin("scenes", header.scene)()
    from rlbench.render.mitsuba.open_tracer import describe_tracer

    file, tracer = paths.cache_folder() / "sample_ms.json", describe_tracer()
    times = json.loads(file.read_text()) if file.is_file() else {}
    size = f"{header.width}x{header.height}"
    key = f"{header.scene} {size} {machine} {tracer} {_code(header.scene)}"
    key += f" {pool}" * (pool != "path")
    if key not in times:
        times[key] = _trace(scene, header, pool)
        with paths.atomic_write(file) as temporary:
            temporary.write_text(json.dumps(times, indent=1))
    return float(times[key]), tracer


def _code(scene: str) -> str:
    """Hash of the code of a scene and of the tracer; empty without such a scene."""
    entry = registry.list_entries("scenes").get(scene)
    if entry is None:
        return ""
    modules = code_hash.import_closure(entry.target.partition(":")[0])
    return code_hash.code_hash(modules, core=["rlbench.render"])


def _trace(scene: Any, header: Header, pool: str) -> float:
    """Milliseconds of one sample per pixel of the scene, traced now."""
    from rlbench.render.jobs.extra_pools import pool_sample_ms
    from rlbench.render.mitsuba.open_tracer import sample_ms

    if pool != "path":
        return float(pool_sample_ms(scene, header.height, header.width, pool))
    return float(sample_ms(scene, header.height, header.width))

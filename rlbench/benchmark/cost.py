"""The cost of a frame's samples and of its G-buffer, measured or published.

`measured` is the time in the clip's header if the clip was rendered on this machine, else the time
of this machine's own path tracer, measured once and cached. `published` is that of a cost profile.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from rlbench import registry
from rlbench.benchmark.cost_profile import CostProfile
from rlbench.benchmark.results import NO_GBUFFER, UNCERTAIN, WIDE, uncertainty
from rlbench.benchmark.sample_clock import open_clock
from rlbench.errors import RlbenchError
from rlbench.system import paths, provenance, store

if TYPE_CHECKING:
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.clips.header import Header

_logger = logging.getLogger(__name__)

UNKNOWN_GBUFFER = (
    "not known, charged as 0: rlbench render --remeasure-sample-time measures it for presets"
)


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
    gbuffer_convention: str = NO_GBUFFER
    scatter: Scatter = FULL_FRAME  # what samples at adaptive counts cost more
    interval: tuple[float, float] = (1.0, 1.0)  # of the time of a sample, relative to it


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
        low, high = _interval(header)
        if is_uncertain(header):
            note = (
                f"{UNCERTAIN} a sample took {low * known_ms:.3g} to {high * known_ms:.3g} ms when "
                "the clip was rendered"
            )
        device = _device(tracer, machine)
        return Cost(known_ms, convention, note, device, interval=(low, high))
    reason = f"rendered on '{header.device}', not here, and "
    if header.scene not in registry.list_entries("scenes"):
        reason += (
            f"'{header.scene}' is not a scene that can be traced here; give your renderer's time: "
            "--cost mine.toml (docs/how-to/charge-your-renderer.md)"
        )
        return Cost(math.nan, convention, reason, machine)
    try:
        sample_ms, tracer = _traced_here(header, machine, pool)
    except Exception as error:  # a missing scene or tracer is a reason, it does not stop a run
        reason += f"cannot be traced here: {type(error).__name__}: {error}"
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
        clock = open_clock()
        return f"{clock.describe()} {clock.describe_code(header.scene)}"
    except Exception as error:  # `measured` gives the reason in its note
        return type(error).__name__


def with_gbuffer(cost: Cost, path_ms: float, header: Header) -> Cost:
    """`cost` with the time of the clip's G-buffer, relative to `path_ms` as its renderer found it.

    A renderer traces a G-buffer once per frame, whatever is sampled. Where the clip does not have
    its time, it is charged as 0.
    """
    if not (header.gbuffer_ms > 0 and header.sample_ms > 0):
        return replace(cost, gbuffer_convention=UNKNOWN_GBUFFER)
    relative = header.gbuffer_ms / header.sample_ms
    convention = f"{relative:.3g} path samples, as measured on '{header.device}'"
    known = path_ms * relative if math.isfinite(path_ms) else 0.0
    return replace(cost, gbuffer_ms=known, gbuffer_convention=convention)


def _device(tracer: str, machine: str) -> str:
    """The device on which this machine's tracer runs."""
    return provenance.machine().gpu if tracer.startswith("cuda") else machine


def is_uncertain(header: Header) -> bool:
    """True if the time of a sample in a header has a wide interval."""
    ms = header.sample_ms
    return uncertainty(ms, *(end * ms for end in _interval(header))) > WIDE


def with_certain_sample(clip: StoredSource) -> StoredSource:
    """The clip, after its time of a sample was measured again if it was uncertain, as far as here.

    That of another machine, and of a scene that is not installed, stays; a warning says why.
    """
    if not is_uncertain(clip.header):
        return clip
    try:
        open_clock().measure_again(clip.folder)
    except RlbenchError as error:
        _logger.warning("the time of a sample of %s stays: %s", clip.header.name, error)
    return replace(clip)  # which reads the header anew


def _interval(header: Header) -> tuple[float, float]:
    """The interval of a header's time of a sample, relative to it; (1, 1) where it is not known."""
    ms, low, high = header.sample_ms, header.sample_p5_ms, header.sample_p95_ms
    return (min(low / ms, 1.0), max(high / ms, 1.0)) if ms > 0 and high > 0 else (1.0, 1.0)


def _traced_here(header: Header, machine: str, pool: str) -> tuple[float, str]:
    """Milliseconds of a sample by this machine's tracer, from the cache or now, and the tracer."""
    clock = open_clock()
    tracer, code = clock.describe(), clock.describe_code(header.scene)
    key = f"{header.scene} {header.width}x{header.height} {machine} {tracer} {code}"
    key += f" {pool}" * (pool != "path")
    measured = header.scene, header.height, header.width, pool
    file = paths.cache_folder() / "sample_ms.json"
    return float(store.recall(file, key, lambda: clock.measure_sample_ms(*measured))), tracer

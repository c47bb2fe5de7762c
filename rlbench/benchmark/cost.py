"""The cost of a frame's samples and of its G-buffer, measured or published.

`measured` is the time in the clip's header if the clip was rendered on this machine, else the time
of this machine's own path tracer, measured once and cached. Any other name is a cost profile:
published times of a renderer, and of methods, on a named machine.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rlbench import registry
from rlbench.benchmark.results import NO_GBUFFER, UNCERTAIN, WIDE, uncertainty
from rlbench.benchmark.sample_clock import open_clock
from rlbench.errors import RlbenchError
from rlbench.registry.near_names import suggest
from rlbench.system import documents, paths, provenance

if TYPE_CHECKING:
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.clips.header import Header

_logger = logging.getLogger(__name__)

MEASURED = "measured"  # the name of no profile: times of this machine
PROFILES = Path(__file__).parent / "profiles"
TABLES = ("scene_ms", "inference_ms")
PAGE = "docs/how-to/charge-your-renderer.md has one to copy"
UNKNOWN_GBUFFER = (
    "not known, charged as 0: rlbench render --remeasure-sample-time measures it for presets"
)


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

    `default_ms` alone is a profile: it is then the time at the size of the clips. Without
    `inference_ms`, inference is measured here, on another device than the samples.
    """

    default_ms: float  # for scenes that are not in scene_ms
    title: str = ""
    source: str = "a cost file"
    device: str = "your renderer"
    height: int = 0  # pixels; 0 where the times are those of the clips' size
    width: int = 0  # pixels
    scene_ms: Mapping[str, float] = field(default_factory=dict)
    inference_ms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # by size, as in "720x720" (width x height), and method

    def sample(self, scene: str, height: int, width: int) -> ProfileTime:
        """The scene's published time, scaled linearly in pixels from the profile's size.

        >>> profile("paper-2080ti").sample("city", 360, 720).ms
        17.25
        """
        own = self.height * self.width
        share = height * width / own if own else 1.0
        note = "" if scene in self.scene_ms else f"the profile's default, as it has no '{scene}'"
        ms = self.scene_ms.get(scene, self.default_ms) * share
        size = f"{self.width}x{self.height}" if own else ""
        return ProfileTime(ms, self._convention(size), note)

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
        how = f"scaled by pixels from {size}" if size else "at the size of the clip"
        return f"{self.device}, {self.source}, {how}"


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


def write_profile(
    file: Path,
    device: str,
    size: tuple[int, int],
    sample_ms: float,
    inference_ms: Mapping[str, Mapping[str, float]],
) -> None:
    """Write a cost profile of one device, for all scenes; `size` (height, width) is of a sample."""
    height, width = size
    document = {
        "title": device,
        "source": "rlbench speed --as-cost",
        "device": device,
        "height": height,
        "width": width,
        "default_ms": sample_ms,
        "scene_ms": {},
        "inference_ms": inference_ms,
    }
    documents.write_toml(file, document)


def _check(name: str, document: Mapping[str, Any]) -> None:
    """Raise CostError for missing and unknown keys, and for numbers that are no times or sizes."""
    required = ["default_ms"]
    if "inference_ms" in document or {"height", "width"} & document.keys():
        required += ["height", "width"]
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
    """True for a finite number of at least `minimum`."""
    return isinstance(value, int | float) and minimum <= value < math.inf


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
    file, tracer = paths.cache_folder() / "sample_ms.json", clock.describe()
    times = json.loads(file.read_text()) if file.is_file() else {}
    code = clock.describe_code(header.scene)
    key = f"{header.scene} {header.width}x{header.height} {machine} {tracer} {code}"
    key += f" {pool}" * (pool != "path")
    if key not in times:
        times[key] = clock.measure_sample_ms(header.scene, header.height, header.width, pool)
        with paths.atomic_write(file) as temporary:
            temporary.write_text(json.dumps(times, indent=1))
    return float(times[key]), tracer

"""The only clock: time to plan and to denoise each frame on this device.

A method never times itself. It runs through the same page as in the benchmark, on real states,
inside a wrapper with a stopwatch. The device is synchronized before and after each reading.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain, islice, repeat

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.frames import Clip, GBuffer, Samples
from rlbench.method import Method, State
from rlbench.run import run_clip
from rlbench.system import provenance
from rlbench.wrappers import MethodWrapper

__all__ = ["REPEATS", "WARM_UP", "TimePercentiles", "Timing", "device_name", "time_method"]

WARM_UP = 2  # frames before the first timed one
REPEATS = 10  # timed frames


@dataclass(frozen=True)
class TimePercentiles:
    """Percentiles of a time over frames, milliseconds."""

    p50: float
    p95: float
    n: int  # frames


@dataclass(frozen=True)
class Timing:
    """Times of one frame through one method; the passes of a frame are added up."""

    plan: TimePercentiles
    sample_fetch: TimePercentiles  # reading stored samples after the pilot; not part of frame_ms
    denoise: TimePercentiles
    inference: TimePercentiles  # plan + denoise of the same frame
    clip: str  # name of the timed clip; clips that take the same time are timed once


def time_method(method: Method, clip: Clip, target_spp: float, repeats: int = REPEATS) -> Timing:
    """Times per frame of `method`, over `repeats` frames after `WARM_UP` frames.

    The clip restarts as often as needed. Fetching samples is timed separately: in a renderer the
    path tracer takes its place, which the cost of a sample accounts for.
    """
    device = next(iter(clip)).pool.empty().counts.device
    timed = TimedMethod(method, _Stopwatch(device))
    frames = chain.from_iterable(run_clip(timed, clip, target_spp) for _ in repeat(None))
    readings = [timed.clock.read_and_reset() for _ in islice(frames, WARM_UP + repeats)]
    plan, fetch, denoise = zip(*readings[WARM_UP:], strict=True)
    inference = [p + d for p, d in zip(plan, denoise, strict=True)]
    return Timing(
        plan=_percentiles(plan),
        sample_fetch=_percentiles(fetch),
        denoise=_percentiles(denoise),
        inference=_percentiles(inference),
        clip=clip.name,
    )


def device_name(device: torch.device) -> str:
    """Model name of a device; of a processor with its threads, because times depend on both."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    if device.type == "cpu":
        return f"{provenance.machine().cpu}, {torch.get_num_threads()} threads"
    return device.type


@dataclass
class _Stopwatch:
    device: torch.device
    plan_end: float | None = None  # when the method last returned from plan
    plan: float = 0.0
    sample_fetch: float = 0.0
    denoise: float = 0.0

    def read_and_reset(self) -> tuple[float, float, float]:
        """Milliseconds of plan, sample fetch and denoise since the last reading."""
        reading = (self.plan, self.sample_fetch, self.denoise)
        self.plan_end, self.plan, self.sample_fetch, self.denoise = None, 0.0, 0.0, 0.0
        return reading

    def enter(self) -> float:
        """The time now; the time since the last plan went into fetching samples."""
        now = _now(self.device)
        if self.plan_end is not None:
            self.sample_fetch += now - self.plan_end
        self.plan_end = None
        return now


@dataclass(frozen=True)
class TimedMethod(MethodWrapper[Method]):
    """The same method with a stopwatch around `plan` and `denoise`."""

    clock: _Stopwatch = field(compare=False)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density, timed."""
        entered = self.clock.enter()
        density = super().plan(gbuffer, samples, state)
        self.clock.plan_end = _now(self.clock.device)
        self.clock.plan += self.clock.plan_end - entered
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image and next state, timed."""
        entered = self.clock.enter()
        result = super().denoise(gbuffer, samples, state)
        self.clock.denoise += _now(self.clock.device) - entered
        return result


def _now(device: torch.device) -> float:
    """Milliseconds on the clock, once the device has nothing left to do."""
    if device.type != "cpu":
        torch.accelerator.synchronize(device)
    return time.perf_counter() * 1e3


def _percentiles(readings: Sequence[float]) -> TimePercentiles:
    ordered = torch.tensor(list(readings), dtype=torch.float64)
    p50, p95 = ordered.quantile(torch.tensor([0.5, 0.95], dtype=torch.float64)).tolist()
    return TimePercentiles(p50, p95, len(ordered))

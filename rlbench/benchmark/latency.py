"""The only clock: what planning and denoising take, frame by frame, on this device.

A method never times itself. It goes through the same page as in the benchmark, on real states, and
a stopwatch stands between it and the page. The device is drained on both sides of each reading.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain, islice, repeat

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.run import run_clip
from rlbench.system import provenance

WARM_UP = 2  # frames run before the first that counts
REPEATS = 10  # frames that count


@dataclass(frozen=True)
class TimePercentiles:
    """A time as what it is: a distribution. Milliseconds."""

    p50: float
    p95: float
    n: int


@dataclass(frozen=True)
class Timing:
    """Times of one frame through one method; a frame's passes are added up."""

    plan: TimePercentiles
    buy: TimePercentiles  # to hand out stored samples, those of a pilot left out; charged to nobody
    denoise: TimePercentiles
    inference: TimePercentiles  # plan + denoise of the same frame
    clip: str  # whose frames were timed: clips of one size take as long, and are timed once


def time_method(method: Method, clip: Clip, spp: float, repeats: int = REPEATS) -> Timing:
    """Times per frame of `method` over `clip`, run again from its start until there are enough.

    The first frames are warm-up and do not count. Buying is timed beside them: in a renderer it is
    the path tracer's part, which the cost per sample stands for.
    """
    device = next(iter(clip)).pool.empty().counts.device
    watch = TimedMethod(method, _Stopwatch(device))
    runs = chain.from_iterable(run_clip(watch, clip, spp) for _ in repeat(None))
    readings = []
    for _ in islice(runs, WARM_UP + repeats):
        readings.append(watch.clock.reading())
    plan, buy, denoise = zip(*readings[WARM_UP:], strict=True)
    both = [p + d for p, d in zip(plan, denoise, strict=True)]
    return Timing(_spread(plan), _spread(buy), _spread(denoise), _spread(both), clip.name)


def device_name(device: torch.device) -> str:
    """The model name of what runs a method, of a processor with its threads: a time needs both."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    if device.type == "cpu":
        return f"{provenance.machine().cpu}, {torch.get_num_threads()} threads"
    return device.type


@dataclass
class _Stopwatch:
    device: torch.device
    left: float | None = None  # when the method last returned from plan
    plan: float = 0.0
    buy: float = 0.0
    denoise: float = 0.0

    def reading(self) -> tuple[float, float, float]:
        """Milliseconds of plan, buy and denoise since the last reading."""
        told = (self.plan, self.buy, self.denoise)
        self.left, self.plan, self.buy, self.denoise = None, 0.0, 0.0, 0.0
        return told

    def enter(self) -> float:
        """The time now; what went by since the last plan was spent buying."""
        now = _now(self.device)
        if self.left is not None:
            self.buy += now - self.left
        self.left = None
        return now


@dataclass(frozen=True)
class TimedMethod:
    """The same method with a stopwatch between it and the page."""

    method: Method
    clock: _Stopwatch = field(compare=False)

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """As the method's, timed."""
        entered = self.clock.enter()
        density = self.method.plan(gbuffer, samples, state)
        self.clock.left = _now(self.clock.device)
        self.clock.plan += self.clock.left - entered
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """As the method's, timed."""
        entered = self.clock.enter()
        shown = self.method.denoise(gbuffer, samples, state)
        self.clock.denoise += _now(self.clock.device) - entered
        return shown


def _now(device: torch.device) -> float:
    """Milliseconds on the clock, once the device has nothing left to do."""
    if device.type != "cpu":
        torch.accelerator.synchronize(device)
    return time.perf_counter() * 1e3


def _spread(readings: Sequence[float]) -> TimePercentiles:
    ordered = torch.tensor(list(readings), dtype=torch.float64)
    p50, p95 = ordered.quantile(torch.tensor([0.5, 0.95], dtype=torch.float64)).tolist()
    return TimePercentiles(p50, p95, len(ordered))

"""The clocks of a machine, a stopwatch for the parts of a frame, and how busy the machine is.

A method never times itself. It runs through the same page as in the benchmark, inside a wrapper
with a stopwatch. The device is synchronized before each reading; a GPU's own clock is read beside
it, by events in its queue. A calibration kernel, fixed work, shows by its time how busy the machine
is.
"""

from __future__ import annotations

import math
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.frames import Frame, GBuffer, PoolWrapper, Samples
from rlbench.method import Method, State
from rlbench.sanitize import FrameInput, sanitize_frame
from rlbench.system import load
from rlbench.system.load import MIN_PROCESSOR_SHARE
from rlbench.wrappers import MethodWrapper

PARTS = ("plan", "allocate", "denoise")  # of inference, in the order of a frame
SETTLE_SECONDS = 0.01  # idle threads of TBB look for work for 1 to 5 ms
SLOWDOWN = 1.25  # times a quiet calibration; beyond it the machine is busy
REPEATS = 9  # runs of the kernel in one calibration
SIDE = {"cpu": 256}  # of the kernel's matrices: about a millisecond
ACCELERATOR_SIDE = 2048


@dataclass(frozen=True)
class SystemClock:
    """The clocks of this machine, for work on `device`; tests have one whose time they set."""

    device: torch.device

    def wall_ms(self) -> float:
        """Milliseconds of the monotonic clock, after the device has finished its work."""
        if self.device.type != "cpu":
            torch.accelerator.synchronize(self.device)
        return time.perf_counter() * 1e3

    def processor_ms(self) -> float:
        """Processor time of this process, all threads together."""
        return load.processor_ms()

    def waiting_ms(self) -> float:
        """Time of all threads in the queue for a processor; nan but on Linux and processors."""
        return load.waiting_ms() if self.device.type == "cpu" else math.nan

    def mark(self) -> torch.Event | None:
        """An event in the device's queue, which has the device's time; None on a processor."""
        if self.device.type == "cpu":
            return None
        event = torch.Event(self.device, enable_timing=True)
        event.record()
        return event

    def context_switches(self) -> int:
        """Involuntary context switches of this process; 0 where the system does not count them."""
        try:
            import resource
        except ImportError:  # Windows
            return 0
        return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw

    def settle(self) -> None:
        """Wait for longer than the threads of Open Image Denoise look for work after a frame."""
        time.sleep(SETTLE_SECONDS)


class FrameTime(NamedTuple):
    """Times of one frame, milliseconds; the passes of a frame are added up."""

    plan: float
    allocate: float  # density to counts; 0 for a method that does not adapt
    denoise: float
    sample_fetch: float  # reading samples; a renderer traces them instead
    processor: float  # processor time of plan, allocate and denoise, all threads together
    device: float  # time of the same between events in the device's queue; nan on a processor
    switches: int  # involuntary context switches in the whole frame

    @property
    def inference(self) -> float:
        """plan + allocate + denoise."""
        return self.plan + self.allocate + self.denoise


class Reading(NamedTuple):
    """All clocks at one moment."""

    wall: float
    processor: float
    mark: torch.Event | None

    def device_ms(self, before: Reading) -> float:
        """Time of the device since another reading; nan on a processor."""
        if before.mark is None or self.mark is None:
            return math.nan
        return before.mark.elapsed_time(self.mark)


@dataclass
class Stopwatch:
    """Charges the time between two readings to one part of a frame."""

    clock: SystemClock
    is_drawing: bool = False  # between `plan` and what follows it: samples are drawn
    _parts: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    _processor: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    _device: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    _last: Reading = Reading(0.0, 0.0, None)
    _switches: int = 0

    def charge(self, part: str) -> None:
        """Charge the time since the last reading to `part`."""
        before = self._last
        self.skip()
        self._parts[part] += self._last.wall - before.wall
        self._processor[part] += self._last.processor - before.processor
        self._device[part] += self._last.device_ms(before)

    def skip(self) -> None:
        """Charge the time since the last reading to nothing."""
        mark = self.clock.mark()  # before the device is waited for
        self._last = Reading(self.clock.wall_ms(), self.clock.processor_ms(), mark)

    def end_drawing(self) -> None:
        """Begin a part; the time since `plan` went into turning its density into counts."""
        if self.is_drawing:
            self.charge("allocate")
        else:
            self.skip()
        self.is_drawing = False

    def read_and_reset(self, is_adaptive: bool) -> FrameTime:
        """The times of the frame since the last call.

        A method that does not adapt has the same counts in every frame, so allocation costs it
        nothing.
        """
        switches, parts = self.clock.context_switches(), self._parts
        times = (parts, self._processor, self._device)
        if not is_adaptive:
            for each in times:
                each["allocate"] = 0.0
        reading = FrameTime(
            plan=parts["plan"],
            allocate=parts["allocate"],
            denoise=parts["denoise"],
            sample_fetch=parts["sample_fetch"],
            processor=_inference(self._processor),
            device=_inference(self._device),
            switches=switches - self._switches,
        )
        for each in times:
            each.clear()
        self._switches = switches
        return reading


def _inference(times: Mapping[str, float]) -> float:
    return sum(times[name] for name in PARTS)


@dataclass(frozen=True)
class TimedMethod(MethodWrapper[Method]):
    """The same method with a stopwatch around `plan` and `denoise`."""

    stopwatch: Stopwatch = field(compare=False)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density, timed."""
        self.stopwatch.end_drawing()
        density = super().plan(gbuffer, samples, state)
        self.stopwatch.charge("plan")
        self.stopwatch.is_drawing = True
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image and next state, timed."""
        self.stopwatch.end_drawing()
        result = super().denoise(gbuffer, samples, state)
        self.stopwatch.charge("denoise")
        return result


@dataclass(frozen=True)
class TimedPool(PoolWrapper):
    """A pool whose reading of samples is timed apart from the allocation of counts."""

    stopwatch: Stopwatch

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """Radiance of the samples, timed unless they belong to the pilot."""
        if self.stopwatch.is_drawing:
            self.stopwatch.charge("allocate")
        radiance = super().read(before, counts)
        if self.stopwatch.is_drawing:
            self.stopwatch.charge("sample_fetch")
        return radiance


def timed_reader(stopwatch: Stopwatch) -> Callable[[Frame, frozenset[str]], FrameInput]:
    """`sanitize_frame` with a timed pool, to be passed to `rlbench.run_clip` as `read`."""

    def read(frame: Frame, inputs: frozenset[str]) -> FrameInput:
        valid = sanitize_frame(frame, inputs)
        return valid._replace(pool=TimedPool(valid.pool, stopwatch))

    return read


class Calibration(NamedTuple):
    """One reading of the kernel."""

    ms: float  # median of its runs
    processor_share: float  # time running / (running + waiting for a processor); nan: unknown

    def is_quiet(self, quiet_ms: float) -> bool:
        """True if the machine was as quiet as it is in this session, and ours alone."""
        is_shared = self.processor_share < MIN_PROCESSOR_SHARE  # false for nan
        return self.ms <= SLOWDOWN * quiet_ms and not is_shared

    def speed(self, quiet_ms: float) -> float:
        """Share of the quiet machine's speed, by the kernel's time or its share of processors."""
        is_known = not math.isnan(self.processor_share)
        return min(self.processor_share if is_known else 1.0, quiet_ms / self.ms, 1.0)


@dataclass(frozen=True)
class Calibrator:
    """Runs the kernel between the clocks.

    A constant load slows every calibration. It is found by the time that the kernel's
    threads wait for a processor, as the system's scheduler counts it. Threads of the row before
    that still look for work would count as such a load, so a reading first lets them fall asleep.
    """

    clock: SystemClock
    kernel: Callable[[], object]

    def measure(self) -> Calibration:
        """One reading, the median of a few runs."""
        self.clock.settle()
        ran, waited = self.clock.processor_ms(), self.clock.waiting_ms()
        times = [self.clock.wall_ms()]
        for _ in range(REPEATS):
            self.kernel()
            times.append(self.clock.wall_ms())
        ran, waited = self.clock.processor_ms() - ran, self.clock.waiting_ms() - waited
        runs = [after - before for before, after in zip(times, times[1:], strict=False)]
        return Calibration(statistics.median(runs), load.running_share(ran, waited))


def make_kernel(device: torch.device) -> Callable[[], object]:
    """Matrix products and a pass over memory, as in a denoiser."""
    side = SIDE.get(device.type, ACCELERATOR_SIDE)
    matrix = torch.rand(side, side, device=device)
    image = torch.rand(8, side, side, device=device)

    @torch.inference_mode()
    def kernel() -> object:
        return (matrix @ matrix @ matrix).sum() + (image * matrix).relu().sum()

    return kernel


def load_average() -> float:
    """Mean number of runnable processes in the last minute; nan where the system has no such."""
    getloadavg = getattr(os, "getloadavg", None)  # not on Windows
    return float(getloadavg()[0]) if getloadavg else math.nan

"""The calibration kernel: fixed work whose time shows how busy the machine is."""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch

from rlbench.benchmark.clock.stopwatch import Clock

__all__ = [
    "MIN_PROCESSOR_SHARE",
    "SLOWDOWN",
    "Calibration",
    "Calibrator",
    "load_average",
    "make_kernel",
]

SLOWDOWN = 1.25  # times a quiet calibration; beyond it the machine is busy
MIN_PROCESSOR_SHARE = 0.8  # of the processor time that its threads ask for, on a quiet machine
REPEATS = 9  # runs of the kernel in one calibration
SIDE = {"cpu": 256}  # of the kernel's matrices: about a millisecond
ACCELERATOR_SIDE = 2048


class Calibration(NamedTuple):
    """One reading of the kernel."""

    ms: float  # median of its runs
    processor_share: float  # time running / (running + waiting for a processor); nan: unknown

    def is_quiet(self, quiet_ms: float) -> bool:
        """Was the machine as quiet as it is in this session, and ours alone?"""
        is_shared = self.processor_share < MIN_PROCESSOR_SHARE  # false for nan
        return self.ms <= SLOWDOWN * quiet_ms and not is_shared


@dataclass(frozen=True)
class Calibrator:
    """Runs the kernel between the clocks.

    A constant load slows every calibration. It is found by the time that the kernel's
    threads wait for a processor, as the system's scheduler counts it. Threads of the row before
    that still look for work would count as such a load, so a reading first lets them fall asleep.
    """

    clock: Clock
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
        share = ran / (ran + waited) if ran + waited > 0 else math.nan
        return Calibration(statistics.median(runs), share)


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

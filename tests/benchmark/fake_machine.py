"""A machine whose clocks, load and methods are known: nothing sleeps, and nothing is random."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch

from rlbench.benchmark.clock import Calibrator
from rlbench.family import Traits


@dataclass(frozen=True)
class Mark:
    """A moment of the device's clock."""

    ms: float

    def elapsed_time(self, end):
        return end.ms - self.ms


@dataclass
class Machine:
    """Work takes its time x the slowdown at that moment; other programs take processor share."""

    slowdown: Callable[[float], float] = lambda ms: 1.0
    processor_share: Callable[[float], float] = lambda ms: 1.0
    now: float = 0.0
    processor: float = 0.0
    waiting: float = 0.0
    switches: int = 0
    busy_threads: int = 0  # of this process, which look for work and find none
    device_share: float = math.nan  # of the time, which a device's clock counts

    def wall_ms(self):
        return self.now

    def processor_ms(self):
        return self.processor

    def waiting_ms(self):
        return self.waiting

    def mark(self):
        return None if math.isnan(self.device_share) else Mark(self.now * self.device_share)

    def context_switches(self):
        return self.switches

    def settle(self):
        self.busy_threads = 0

    def work(self, ms):
        taken = ms * self.slowdown(self.now)
        share = self.processor_share(self.now) / (1 + self.busy_threads)
        self.processor += taken * share
        self.waiting += taken * (1 - share)
        self.now += taken

    def calibrator(self):
        return Calibrator(self, lambda: self.work(2.0))


@dataclass(frozen=True)
class Worker:
    """A method with known times on a machine; `jitter` varies the time of each frame."""

    machine: Machine
    plan_ms: float = 1.0
    denoise_ms: float = 9.0
    jitter: float = 0.0
    busy_threads: int = 0  # that go on looking for work after a frame
    traits: Traits = Traits()
    states: list[object] = field(default_factory=list)

    def start(self, size):
        return 0

    def plan(self, gbuffer, samples, state):
        self.machine.work(self.plan_ms)
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        wave = math.sin(2.4 * len(self.states))  # covers [-1, 1] evenly enough
        self.machine.work(self.denoise_ms * (1 + self.jitter * wave))
        self.states.append(state)
        self.machine.busy_threads = self.busy_threads
        return samples.mean, state + 1

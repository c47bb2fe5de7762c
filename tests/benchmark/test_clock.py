"""What the stopwatch charges to which part, on real pools."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass

import pytest
import torch

from rlbench.benchmark.clock import (
    Calibration,
    Stopwatch,
    SystemClock,
    TimedMethod,
    timed_reader,
)
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import run_clip
from rlbench.sampling import allocate_counts
from rlbench.sanitize import sanitize_frame
from tests.benchmark.fake_machine import Machine, Worker

CLIP = procedural_clip(size=Size(1, 8, 8), frames=2)


@dataclass(frozen=True)
class SlowPool:
    """A pool that takes 5 ms to read."""

    pool: object
    machine: Machine

    def __getattr__(self, name):
        return getattr(self.pool, name)

    def read(self, before, counts):
        self.machine.work(5.0)
        return self.pool.read(before, counts)


@pytest.fixture
def reading(monkeypatch):
    """Reads the first frame on a machine where allocation takes 3 ms and a read 5 ms."""
    machine = Machine()
    stopwatch = Stopwatch(machine)

    def slow(*arguments):
        machine.work(3.0)
        return allocate_counts(*arguments)

    def sanitized(frame, inputs):
        frame = sanitize_frame(frame, inputs)
        return frame._replace(pool=SlowPool(frame.pool, machine))

    def read(traits):
        worker = TimedMethod(Worker(machine, 1.0, 9.0, traits=traits), stopwatch)
        next(iter(run_clip(worker, CLIP, 2.0, timed_reader(stopwatch))))
        return stopwatch.read_and_reset(traits.adaptive)

    monkeypatch.setattr("rlbench.benchmark.clock.sanitize_frame", sanitized)
    monkeypatch.setattr("rlbench.sampling.allocate_counts", slow)
    return read


@pytest.mark.parametrize(
    ("traits", "plan", "allocate", "fetch"),
    [
        (Traits(adaptive=True), 1.0, 3.0, 5.0),
        (Traits(), 1.0, 0.0, 5.0),
        # all passes count, and the pilot does not
        (Traits(adaptive=True, pilot_spp=0.5, passes=(0.5, 1.0)), 2.0, 6.0, 10.0),
    ],
)
def test_allocation_is_charged_apart_from_reading_samples(reading, traits, plan, allocate, fetch):
    frame = reading(traits)
    parts = (frame.plan, frame.allocate, frame.denoise, frame.sample_fetch)
    assert parts == pytest.approx((plan, allocate, 9.0, fetch))
    assert frame.inference == frame.processor == pytest.approx(plan + allocate + 9.0)


def test_threads_that_compete_wait_for_a_processor():
    """Twice as many busy threads as processors: half of their time passes in the queue."""
    clock = SystemClock(torch.device("cpu"))
    if math.isnan(clock.waiting_ms()):
        pytest.skip("this system does not count the time in the queue")
    busy = "import time; end = time.time() + 0.6\nwhile time.time() < end: pass"
    others = [subprocess.Popen([sys.executable, "-c", busy]) for _ in range(2 * os.cpu_count())]
    time.sleep(0.2)  # they start
    ran, waited = clock.processor_ms(), clock.waiting_ms()
    end = time.time() + 0.3
    while time.time() < end:
        pass
    ran, waited = clock.processor_ms() - ran, clock.waiting_ms() - waited
    for other in others:
        other.wait()
    assert waited > 0.2 * ran
    assert math.isnan(SystemClock(torch.device("meta")).waiting_ms())


@pytest.mark.parametrize(
    ("calibration", "quiet"),
    [
        (Calibration(1.0, 1.0), True),
        (Calibration(1.24, 1.0), True),
        (Calibration(1.26, 1.0), False),
        (Calibration(1.0, 0.7), False),
        (Calibration(1.0, float("nan")), True),  # an accelerator
    ],
)
def test_a_calibration_is_quiet_by_its_time_and_its_share(calibration, quiet):
    assert calibration.is_quiet(1.0) == quiet
    assert not calibration._replace(ms=2.0).is_quiet(1.0)

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
    Calibrator,
    Stopwatch,
    SystemClock,
    TimedMethod,
    make_kernel,
    timed_reader,
)
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import run_clip
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


def reading(traits, allocation_ms=3.0, monkeypatch=None):
    """The first frame's reading on a machine where allocation takes 3 ms and a read 5 ms."""
    machine = Machine()
    stopwatch = Stopwatch(machine)
    worker = Worker(machine, 1.0, 9.0, traits=traits)
    monkeypatch.setattr(
        "rlbench.benchmark.clock.sanitize_frame",
        lambda frame, inputs: sanitize_frame(frame, inputs)._replace(
            pool=SlowPool(frame.pool, machine)
        ),
    )
    allocate = __import__("rlbench.sampling", fromlist=["_"]).allocate_counts

    def slow(*arguments):
        machine.work(allocation_ms)
        return allocate(*arguments)

    monkeypatch.setattr("rlbench.sampling.allocate_counts", slow)
    read = timed_reader(stopwatch)
    next(iter(run_clip(TimedMethod(worker, stopwatch), CLIP, 2.0, read)))
    return stopwatch.read_and_reset(traits.adaptive)


def test_allocation_is_charged_apart_from_reading_samples(monkeypatch):
    frame = reading(Traits(adaptive=True), monkeypatch=monkeypatch)
    assert (frame.plan, frame.allocate, frame.denoise) == pytest.approx((1.0, 3.0, 9.0))
    assert frame.sample_fetch == pytest.approx(5.0)
    assert frame.inference == pytest.approx(13.0)
    assert frame.processor == pytest.approx(13.0)


def test_a_method_that_does_not_adapt_pays_no_allocation(monkeypatch):
    frame = reading(Traits(), monkeypatch=monkeypatch)
    assert (frame.allocate, frame.inference) == (0.0, pytest.approx(10.0))
    assert frame.processor == pytest.approx(10.0)


def test_all_passes_count_and_the_pilot_does_not(monkeypatch):
    traits = Traits(adaptive=True, pilot_spp=0.5, passes=(0.5, 1.0))
    frame = reading(traits, monkeypatch=monkeypatch)
    assert (frame.plan, frame.allocate) == pytest.approx((2.0, 6.0))
    assert frame.sample_fetch == pytest.approx(10.0)


def test_the_kernel_of_this_machine_has_a_time_and_a_share():
    device = torch.device("cpu")
    calibration = Calibrator(SystemClock(device), make_kernel(device)).measure()
    assert calibration.ms > 0
    assert 0 < calibration.processor_share <= 1 or math.isnan(calibration.processor_share)


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

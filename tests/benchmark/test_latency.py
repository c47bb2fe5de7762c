"""The clock against planted contention: slow phases, a load that never ends, and drift."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import pytest
import torch
from scipy import stats

from rlbench.benchmark.latency import (
    Limits,
    TimedRow,
    device_name,
    half_width,
    is_steady,
    median_ranks,
    middle_half,
    time_methods,
)
from rlbench.benchmark.results import WIDE, uncertainty
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.system import provenance
from tests.benchmark.fake_machine import Machine, Worker

CLIP = procedural_clip(size=Size(1, 8, 8), frames=4)

CPU = torch.device("cpu")


def time_rows(machine, *workers, repeats=10):
    rows = [TimedRow(worker, CLIP, 1.0) for worker in workers]
    return time_methods(rows, CPU, repeats, machine.calibrator())


def test_on_a_quiet_machine_the_time_is_exact_and_its_interval_narrow():
    machine, done = Machine(), []
    workers = Worker(machine), Worker(machine)
    rows = [TimedRow(worker, CLIP, 1.0) for worker in workers]
    timing, _ = time_methods(rows, CPU, 10, machine.calibrator(), lambda: done.append(1))
    assert (timing.plan.mean, timing.denoise.mean) == pytest.approx((1.0, 9.0))
    assert timing.inference.p50 == timing.inference.p95 == pytest.approx(10.0)
    assert (timing.low, timing.high) == pytest.approx((10.0, 10.0))
    assert timing.disturbance == ""
    assert timing.rounds == Limits.of_repeats(10).min_rounds
    assert timing.processor_share == timing.calibration_ratio == pytest.approx(1.0)
    assert len(done) == 2
    for worker in workers:  # each keeps one running clip
        assert worker.states[:6] == [0, 1, 2, 3, 0, 1]


@pytest.mark.parametrize("share", [math.nan, 0.75])
def test_the_clock_of_a_device_is_read_beside_that_of_the_wall(share):
    machine = Machine(device_share=share)
    (timing,) = time_rows(machine, Worker(machine))
    assert timing.device_share == pytest.approx(share, nan_ok=True)
    assert timing.inference.mean == pytest.approx(10.0)


@pytest.mark.parametrize("phase", [(0, 100), (60, 250), (100, 400)])
def test_a_slow_phase_does_not_change_the_median(phase):
    start, end = phase
    machine = Machine(slowdown=lambda ms: 3.0 if start <= ms < end else 1.0)
    (timing,) = time_rows(machine, Worker(machine, jitter=0.02))
    assert timing.inference.p50 == pytest.approx(10.0, rel=0.02)
    assert timing.inference.p95 < 10.5
    assert timing.disturbance == ""


def test_a_load_that_changes_without_end_is_reported():
    machine = Machine(slowdown=lambda ms: 2.0 + math.sin(ms / 40))
    (timing,) = time_rows(machine, Worker(machine))
    assert timing.disturbance.startswith("the machine was busy in ")
    assert "times a quiet moment" in timing.disturbance
    assert timing.low <= 10.0 <= timing.high


def test_a_constant_load_is_reported_by_the_share_of_the_processors():
    """Every calibration is as slow as any other, so its time alone would show nothing."""
    machine = Machine(slowdown=lambda ms: 2.0, processor_share=lambda ms: 0.5)
    (timing,) = time_rows(machine, Worker(machine))
    assert "the machine was busy in 10 of 10 rounds" in timing.disturbance
    assert "50% of the processor time it asked for" in timing.disturbance
    assert timing.inference.p50 == pytest.approx(20.0)
    assert timing.inference.mean == pytest.approx(10.0)  # half of the processor, half of the time
    assert timing.plan.mean + timing.denoise.mean == pytest.approx(timing.inference.mean)
    assert (timing.low, timing.high) == pytest.approx((5.0, 20.0))


@pytest.mark.parametrize("share", [0.75, 0.5, 0.34])
@pytest.mark.parametrize("threads", [1, 2])
def test_the_interval_on_a_busy_machine_holds_the_quiet_time(share, threads):
    """Threads that wait for each other need a share of the processor at the same time."""
    machine = Machine(slowdown=lambda ms: share**-threads, processor_share=lambda ms: share)
    (timing,) = time_rows(machine, Worker(machine, jitter=0.05))
    assert timing.low <= 10.0 <= timing.high
    assert uncertainty(timing.inference.mean, timing.low, timing.high) > WIDE


def test_threads_that_look_for_work_after_a_frame_are_no_load():
    machine = Machine()
    timings = time_rows(machine, Worker(machine), Worker(machine, busy_threads=2))
    assert [timing.disturbance for timing in timings] == ["", ""]
    assert timings[0].processor_share == pytest.approx(1.0)


def test_a_time_that_never_gets_steady_is_reported_with_its_interval():
    machine = Machine()
    steady, unsteady = time_rows(machine, Worker(machine), Worker(machine, jitter=0.6))
    assert steady.disturbance == ""
    assert unsteady.disturbance.startswith("the 95% interval of the median is +-")
    assert unsteady.high - unsteady.low > 5 * (steady.high - steady.low)
    assert unsteady.rounds == Limits.of_repeats(10).max_rounds
    assert unsteady.half_width > 0.02
    slow = Machine()  # rows stop at the cap of wall time
    (timing,) = time_rows(slow, Worker(slow, denoise_ms=2000.0, jitter=0.5))
    assert timing.rounds == Limits.of_repeats(10).min_rounds
    assert timing.disturbance


def test_interleaved_rows_share_a_drift():
    """A processor that warms up loses 8 % in this test: within what calibrations tolerate."""

    def drift(ms):
        return 1.0 + 0.08 * min(ms / 1000, 1.0)

    machine = Machine(slowdown=drift)
    first, second = time_rows(
        machine, Worker(machine, denoise_ms=9.0), Worker(machine, denoise_ms=19.0)
    )
    assert second.inference.p50 / first.inference.p50 == pytest.approx(2.0, rel=0.01)

    alone = Machine(slowdown=drift)  # the planted fault: one row after the other
    (first,) = time_rows(alone, Worker(alone, denoise_ms=9.0))
    (second,) = time_rows(alone, Worker(alone, denoise_ms=19.0))
    assert second.inference.p50 / first.inference.p50 > 2.02


def test_parts_add_up_over_the_same_frames():
    machine = Machine()
    adaptive = Traits(adaptive=True, passes=(0.5, 1.0))
    (timing,) = time_rows(machine, Worker(machine, jitter=0.3, traits=adaptive))
    parts = timing.plan.mean + timing.allocate.mean + timing.denoise.mean
    assert timing.inference.mean == parts
    assert timing.plan.mean == pytest.approx(2.0)  # of both passes


def test_a_row_that_fails_does_not_stop_the_others():
    class Broken(Worker):
        def denoise(self, gbuffer, samples, state):
            raise RuntimeError("no luck")

    machine = Machine()
    error, timing = time_rows(machine, Broken(machine), Worker(machine))
    assert isinstance(error, RuntimeError)
    assert timing.inference.p50 == pytest.approx(10.0)


@dataclass(frozen=True)
class Compiled(Worker):
    """It compiles for a minute before its first frame."""

    def denoise(self, gbuffer, samples, state):
        self.machine.work(0.0 if self.states else 60_000.0)
        return super().denoise(gbuffer, samples, state)


def test_the_first_use_is_counted_apart():
    machine = Machine()
    compiled, plain = time_rows(machine, Compiled(machine), Worker(machine))
    assert (compiled.first_use_ms, plain.first_use_ms) == pytest.approx((60_000.0, 0.0))
    assert compiled.inference.mean == pytest.approx(10.0)
    assert compiled.rounds == plain.rounds  # it is not cut short for the time of its compilation


def test_a_busy_moment_within_a_long_round_is_seen():
    """Calibrations come every half second, not only between rounds."""
    machine = Machine(slowdown=lambda ms: 5.0 if 1000 < ms < 3000 else 1.0)
    rows = [Worker(machine, denoise_ms=60.0) for _ in range(8)]  # two seconds a round
    for timing in time_rows(machine, *rows):
        assert timing.inference.p95 < 62.0
        assert timing.disturbance == ""


@pytest.mark.parametrize("count", [6, 7, 12, 40, 90, 300])
def test_the_ranks_are_the_narrowest_that_hold_the_median_with_95_percent(count):
    low, high = median_ranks(count)
    miss = 2 * stats.binom.cdf(low, count, 0.5)
    assert miss <= 0.05 < 2 * stats.binom.cdf(low + 1, count, 0.5)
    assert high == count - 1 - low


@pytest.mark.parametrize("count", [0, 5])
def test_few_values_have_no_interval(count):
    assert median_ranks(count) is None
    assert math.isinf(half_width([1.0] * count))


def test_microseconds_need_no_two_percent():
    assert is_steady([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    assert not is_steady([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


@pytest.mark.parametrize(("count", "kept"), [(1, 1), (3, 3), (4, 2), (12, 6), (13, 7)])
def test_the_middle_half_drops_a_quarter_at_each_end(count, kept):
    middle = middle_half(list(range(count)))
    assert len(middle) == kept
    assert sum(middle) / kept == (count - 1) / 2


class SleepingMachine(Machine):
    """Work is sleep, which the real clock times."""

    def work(self, ms):
        time.sleep(ms / 1000)


@pytest.mark.parametrize("repeats", [1, 20])
def test_the_real_clock_times_plan_and_denoise_apart(repeats):
    worker = Worker(SleepingMachine(), 2.0, 4.0)
    (times,) = time_methods([TimedRow(worker, CLIP, 1.0)], CPU, repeats)
    # a sleep is never shorter than requested, and longer on a busy machine
    assert times.plan.p50 >= 2
    assert times.denoise.p50 >= 4
    assert times.inference.p50 >= 6
    assert times.sample_fetch.p50 < times.inference.p50
    assert times.processor_share < 0.9  # it slept
    assert times.frames >= max(repeats, 9)
    assert len(worker.states) > times.frames  # and one untimed frame in each round


@pytest.mark.parametrize(("threads", "words"), [(1, "1 thread"), (2, "2 threads")])
def test_a_processor_is_named_with_its_threads(threads, words):
    torch.set_num_threads(threads)
    assert device_name(CPU) == f"{provenance.machine().cpu}, {words}"

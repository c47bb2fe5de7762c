"""Times of methods: what a stopwatch around plan and denoise counts."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import pytest
import torch

from rlbench.benchmark.latency import WARM_UP, device_name, time_method
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.system import provenance

SIZE = Size(1, 8, 8)


@dataclass(frozen=True)
class Sleepy:
    """A method whose times are known: it sleeps."""

    plan_s: float = 0.0
    denoise_s: float = 0.0
    first_s: float = 0.0
    traits: Traits = Traits()
    states: list[object] = field(default_factory=list)

    def start(self, size):
        return 0

    def plan(self, gbuffer, samples, state):
        time.sleep(self.plan_s)
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        time.sleep(self.denoise_s + (self.first_s if len(self.states) < WARM_UP else 0))
        self.states.append(state)
        return samples.mean, state + 1


def test_plan_and_denoise_are_timed_apart():
    times = time_method(Sleepy(0.004, 0.008), procedural_clip(size=SIZE), 1.0, repeats=3)
    # a sleep is never shorter than requested, and longer on a busy machine
    assert times.plan.p50 >= 4
    assert times.denoise.p50 >= 8
    assert times.inference.p50 >= 12
    assert times.sample_fetch.p50 < times.inference.p50


def test_the_time_of_a_frame_includes_all_passes():
    method = Sleepy(0.004, traits=Traits(passes=(0.5, 1.0)))
    assert time_method(method, procedural_clip(size=SIZE), 1.0, repeats=3).plan.p50 >= 8


@pytest.mark.parametrize("threads", [1, 2])
def test_a_processor_is_named_with_its_threads(threads):
    torch.set_num_threads(threads)
    assert device_name(torch.device("cpu")) == f"{provenance.machine().cpu}, {threads} threads"


def test_warm_up_does_not_count():
    times = time_method(Sleepy(first_s=0.3), procedural_clip(size=SIZE), 1.0, repeats=3)
    assert times.denoise.p95 < 300


@pytest.mark.parametrize("repeats", [1, 3, 10])
def test_the_requested_number_of_frames_is_timed_after_warm_up(repeats):
    method = Sleepy()
    times = time_method(method, procedural_clip(size=SIZE, frames=4), 1.0, repeats)
    assert times.plan.n == times.denoise.n == repeats
    assert len(method.states) == WARM_UP + repeats


def test_the_clip_restarts_with_a_fresh_state():
    method = Sleepy()
    time_method(method, procedural_clip(size=SIZE, frames=3), 1.0, repeats=5)
    assert method.states == [0, 1, 2, 0, 1, 2, 0]

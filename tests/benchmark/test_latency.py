"""Times of methods on this machine: what is counted, and what the frames are."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import pytest
import torch

from rlbench.benchmark.latency import TimedRow, device_name, time_methods
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.system import provenance

SIZE = Size(1, 8, 8)
CPU = torch.device("cpu")


@dataclass(frozen=True)
class Sleepy:
    """A method whose times are known: it sleeps."""

    plan_s: float = 0.0
    denoise_s: float = 0.0
    traits: Traits = Traits()
    states: list[object] = field(default_factory=list)

    def start(self, size):
        return 0

    def plan(self, gbuffer, samples, state):
        time.sleep(self.plan_s)
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        time.sleep(self.denoise_s)
        self.states.append(state)
        return samples.mean, state + 1


def time_rows(*methods, repeats=1, frames=3):
    clip = procedural_clip(size=SIZE, frames=frames)
    return time_methods([TimedRow(method, clip, 1.0) for method in methods], CPU, repeats)


def test_plan_and_denoise_are_timed_apart():
    (times,) = time_rows(Sleepy(0.004, 0.008))
    # a sleep is never shorter than requested, and longer on a busy machine
    assert times.plan.p50 >= 4
    assert times.denoise.p50 >= 8
    assert times.inference.p50 >= 12
    assert times.sample_fetch.p50 < times.inference.p50
    assert times.processor_share < 0.9  # it slept


def test_the_time_of_a_frame_includes_all_passes():
    (times,) = time_rows(Sleepy(0.004, traits=Traits(passes=(0.5, 1.0))))
    assert times.plan.p50 >= 8


@pytest.mark.parametrize("threads", [1, 2])
def test_a_processor_is_named_with_its_threads(threads):
    torch.set_num_threads(threads)
    assert device_name(CPU) == f"{provenance.machine().cpu}, {threads} threads"


@pytest.mark.parametrize("repeats", [1, 20])
def test_at_least_the_requested_number_of_frames_is_timed(repeats):
    (times,) = time_rows(method := Sleepy(), repeats=repeats)
    assert times.frames >= max(repeats, 9)
    assert len(method.states) > times.frames  # and one untimed frame in each round


def test_the_clip_restarts_with_a_fresh_state():
    time_rows(method := Sleepy(), frames=3)
    assert method.states[:7] == [0, 1, 2, 0, 1, 2, 0]

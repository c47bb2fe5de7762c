"""Times: what is counted, what is not, and what a sample costs."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import torch

from rlbench.benchmark import cost
from rlbench.benchmark.cost import Cost, CostError
from rlbench.benchmark.latency import WARM_UP, device_name, time_method
from rlbench.clips.procedural.clip import procedural
from rlbench.clips.stored import read_header
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
    seen: list[object] = field(default_factory=list)

    def start(self, size):
        return 0

    def plan(self, gbuffer, samples, state):
        time.sleep(self.plan_s)
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        time.sleep(self.denoise_s + (self.first_s if len(self.seen) < WARM_UP else 0))
        self.seen.append(state)
        return samples.mean, state + 1


def test_plan_and_denoise_are_timed_apart():
    times = time_method(Sleepy(0.004, 0.008), procedural(size=SIZE), 1.0, repeats=3)
    # sleeping never takes less than asked for; a busy machine makes it longer
    assert times.plan.p50 >= 4
    assert times.denoise.p50 >= 8
    assert times.inference.p50 >= 12
    assert times.buy.p50 < times.inference.p50


def test_all_passes_of_a_frame_are_counted():
    method = Sleepy(0.004, traits=Traits(passes=(0.5, 1.0)))
    assert time_method(method, procedural(size=SIZE), 1.0, repeats=3).plan.p50 >= 8


@pytest.mark.parametrize("threads", [1, 2])
def test_a_processor_is_named_with_its_threads(threads):
    torch.set_num_threads(threads)
    assert device_name(torch.device("cpu")) == f"{provenance.machine().cpu}, {threads} threads"


def test_warm_up_does_not_count():
    times = time_method(Sleepy(first_s=0.3), procedural(size=SIZE), 1.0, repeats=3)
    assert times.denoise.p95 < 300


@pytest.mark.parametrize("repeats", [1, 3, 10])
def test_as_many_frames_as_asked_for_are_timed_after_warm_up(repeats):
    method = Sleepy()
    times = time_method(method, procedural(size=SIZE, frames=4), 1.0, repeats)
    assert times.plan.n == times.denoise.n == repeats
    assert len(method.seen) == WARM_UP + repeats


def test_states_are_those_of_a_clip_run_again_and_again():
    method = Sleepy()
    time_method(method, procedural(size=SIZE, frames=3), 1.0, repeats=5)
    assert method.seen == [0, 1, 2, 0, 1, 2, 0]


@pytest.mark.parametrize(
    ("scene", "published"),
    [("temple", 16.6), ("ripples", 17.6), ("city", 34.5), ("hall", 36.6), ("another", 26.3)],
)
def test_published_times_are_those_of_the_paper(scene, published):
    assert cost.profile("paper-2080ti").cost(scene, 720, 720).sample_ms == published


def test_published_times_are_scaled_by_pixels_and_say_so():
    found = cost.profile("paper-2080ti").cost("temple", 360, 180)
    assert found.sample_ms == pytest.approx(16.6 / 8)
    assert found.convention.endswith("scaled by pixels from 720x720")


def test_a_scene_that_a_profile_does_not_name_is_told():
    found = cost.profile("paper-2080ti").cost("foyer", 720, 720)
    assert found.note == "the profile's default, as it has no 'foyer'"


@pytest.mark.parametrize("scene", ["city", "hall", "foyer"])
def test_costs_of_one_profile_share_a_convention(scene):
    published = cost.profile("paper-2080ti")
    assert published.cost(scene, 96, 96).convention == published.cost("temple", 9, 9).convention


def test_a_profile_may_be_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'title = "t"\nsource = "s"\ndevice = "d"\nheight = 10\nwidth = 10\ndefault_ms = 3\n'
        "[scene_ms]\nfoyer = 5\n"
    )
    assert cost.profile(str(file)).cost("foyer", 10, 10) == Cost(
        5, "d, s, scaled by pixels from 10x10"
    )


@pytest.mark.parametrize("text", ["title = ", 'title = "t"', "colour = 3"])
def test_a_profile_that_cannot_be_read_is_told(tmp_path, text):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(CostError, match="bad.toml' cannot be read"):
        cost.profile(str(tmp_path / "bad.toml"))


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('default_ms = "3"\n[scene_ms]', "default_ms"),
        ("default_ms = nan\n[scene_ms]", "default_ms"),
        ("default_ms = 3\nscene_ms = 4", "scene_ms"),
        ("default_ms = 3\n[scene_ms]\nfoyer = -5", "foyer"),
        ('default_ms = 3\n[scene_ms]\nfoyer = "5"', "foyer"),
    ],
)
def test_a_profile_whose_values_cannot_be_is_told(tmp_path, line, told):
    text = 'title = "t"\nsource = "s"\ndevice = "d"\nheight = 10\nwidth = 10\n'
    (tmp_path / "bad.toml").write_text(text + line)
    with pytest.raises(CostError, match=f"bad.toml': {told} must be numbers"):
        cost.profile(str(tmp_path / "bad.toml"))


def test_an_unknown_profile_lists_those_that_exist():
    with pytest.raises(CostError, match="no cost profile 'x'; there are: measured, paper-2080ti"):
        cost.profile("x")


def test_a_clip_rendered_here_costs_what_its_renderer_wrote(clip_folder):
    here = provenance.machine().name
    header = replace(read_header(clip_folder), device=here, sample_ms=7.5)
    assert cost.measured(header, here).sample_ms == 7.5


def test_a_scene_that_cannot_be_traced_here_has_no_cost_and_a_reason(clip_folder):
    found = cost.measured(read_header(clip_folder), provenance.machine().name)
    assert math.isnan(found.sample_ms)
    assert "rendered on 'another machine', not here" in found.note
    assert "'noise' is not a scene" in found.note


@pytest.mark.slow
def test_a_scene_rendered_elsewhere_is_traced_here_once(clip_folder, tmp_path):
    header = replace(read_header(clip_folder), scene="temple")
    first = cost.measured(header, "here")
    assert first.sample_ms > 0
    assert cost.measured(header, "here") == first
    kept = Path(tmp_path / "cache" / "sample_ms.json")
    ((key, _),) = json.loads(kept.read_text()).items()
    kept.write_text(json.dumps({key.rpartition(" ")[0] + " other-code": 1e9}))
    assert cost.measured(header, "here").sample_ms < 1e6  # of other code, so traced anew

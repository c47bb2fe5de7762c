"""The page: order of calls, passes, and what is bought."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
import torch

from metrics.image import bias
from rlbench.clips.procedural.clip import procedural
from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import run_clip
from rlbench.sampling import BudgetError

SIZE = Size(1, 9, 11)


@dataclass(frozen=True)
class Diary:
    """A method that writes down when it is called, with what count of samples, in what state."""

    traits: Traits = Traits()
    pages: list[tuple[str, int, object]] = field(default_factory=list)

    def start(self, size):
        self.pages.append(("start", size.h * size.w, None))
        return 0

    def plan(self, gbuffer, samples, state):
        self.pages.append(("plan", int(samples.counts.sum()), state))
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        self.pages.append(("denoise", int(samples.counts.sum()), state))
        return samples.mean, state + 1


def diary(traits: Traits, spp: float, frames: int = 2) -> list[tuple[str, int, object]]:
    kept = Diary(traits)
    list(run_clip(kept, procedural(size=SIZE, frames=frames), spp))
    return kept.pages


def test_a_frame_is_planned_bought_and_denoised_in_this_order():
    assert diary(Traits(), 2.0) == [
        ("start", 99, None),
        ("plan", 0, 0),
        ("denoise", 198, 0),
        ("plan", 0, 1),
        ("denoise", 198, 1),
    ]


def test_a_second_pass_sees_what_the_first_one_bought():
    assert diary(Traits(passes=(0.25, 1.0)), 4.0, frames=1) == [
        ("start", 99, None),
        ("plan", 0, 0),
        ("plan", 99, 0),
        ("denoise", 396, 0),
    ]


@pytest.mark.parametrize("spp", [0.0, 0.01, 0.5, 1.0, 3.3, 8.0])
def test_the_budget_is_bought_to_the_sample(spp):
    *_, (_, bought, _) = diary(Traits(), spp, frames=1)
    assert bought == round(spp * 99)


@dataclass(frozen=True)
class Peaked(Diary):
    """A method that wants nearly all of its samples in one corner."""

    def plan(self, gbuffer, samples, state):
        return torch.arange(99.0).view(1, 1, 9, 11) ** 6


@pytest.mark.parametrize(
    ("share", "spp", "fresh"),
    [
        (0.25, 2.0, False),
        (0.8, 1.25, False),
        (0.75, 2.0, False),
        (0.25, 1.0, False),
        (0.25, 2.0, True),
    ],
)
def test_a_floor_is_kept_though_a_first_pass_may_not_pay_for_it(share, spp, fresh):
    traits = Traits(adaptive=True, passes=(share, 1.0), min_samples=1, discard_pilot=fresh)
    (shown,) = run_clip(Peaked(traits), procedural(size=SIZE, frames=1), spp)
    assert int(shown.samples.counts.min()) >= 1
    assert int(shown.samples.counts.sum()) == round(spp * 99)


@pytest.mark.parametrize("floor", [0, 1])
def test_the_floor_is_kept_whatever_is_wished_for(floor):
    clip = procedural(size=SIZE, frames=1)
    (shown,) = run_clip(Peaked(Traits(adaptive=True, min_samples=floor)), clip, 1.2)
    assert int(shown.samples.counts.min()) == floor


def test_the_cap_is_kept_and_what_it_cuts_goes_to_others():
    clip = procedural(size=SIZE, frames=1, pool_spp=16)
    (shown,) = run_clip(Peaked(Traits(adaptive=True, max_samples=5)), clip, 2.0)
    assert int(shown.samples.counts.max()) == 5
    assert int(shown.samples.counts.sum()) == 2 * 99


def test_a_second_pass_keeps_the_samples_of_the_first():
    seen = []

    @dataclass(frozen=True)
    class Two(Diary):
        def plan(self, gbuffer, samples, state):
            seen.append(samples)
            return super().plan(gbuffer, samples, state)

    (shown,) = run_clip(Two(Traits(passes=(0.5, 1.0))), procedural(size=SIZE, frames=1), 2.0)
    before = seen[1]
    assert torch.equal(before.radiance, shown.samples.radiance.where(before.filled, 0.0))


def test_a_method_that_adapts_must_say_so():
    with pytest.raises(PluginError, match="declare Traits"):
        list(run_clip(Peaked(), procedural(size=SIZE), 1.0))
    list(run_clip(Peaked(Traits(adaptive=True)), procedural(size=SIZE), 1.0))


def test_a_density_that_is_no_number_is_told_as_such():
    @dataclass(frozen=True)
    class Broken(Diary):
        def plan(self, gbuffer, samples, state):
            return torch.full((1, 1, 9, 11), torch.nan)

    with pytest.raises(BudgetError, match="not finite"):
        list(run_clip(Broken(), procedural(size=SIZE), 1.0))


def test_a_pilot_is_bought_before_the_method_is_asked():
    assert diary(Traits(pilot_spp=1.0), 4.0, frames=1) == [
        ("start", 99, None),
        ("plan", 99, 0),
        ("denoise", 396, 0),
    ]


@pytest.mark.parametrize("spp", [0.5, 1.0])
def test_a_small_budget_is_all_pilot_and_evenly_spread(spp):
    (shown,) = run_clip(
        Peaked(Traits(adaptive=True, pilot_spp=1.0)), procedural(size=SIZE, frames=1), spp
    )
    counts = shown.samples.counts
    assert int(counts.sum()) == round(spp * 99)
    assert int(counts.max()) == 1


def test_what_a_method_asks_for_after_a_pilot_keeps_the_pilot():
    (shown,) = run_clip(
        Peaked(Traits(adaptive=True, pilot_spp=2.0)), procedural(size=SIZE, frames=1), 3.0
    )
    assert int(shown.samples.counts.min()) == 2
    assert int(shown.samples.counts.sum()) == 297


@pytest.mark.parametrize("pilot", [-1.0, float("nan")])
def test_a_pilot_of_less_than_nothing_is_refused(pilot):
    with pytest.raises(ValueError, match="it is 0 or more"):
        Traits(pilot_spp=pilot)


@pytest.mark.parametrize("passes", [(), (0.5,), (0.5, 0.5, 1.0), (1.0, 0.5), (0.0, 1.0), (2.0,)])
def test_passes_that_do_not_rise_to_the_whole_budget_are_refused(passes):
    with pytest.raises(ValueError, match="must rise from above 0 to 1.0"):
        Traits(passes=passes)


def test_a_method_never_sees_a_buffer_that_it_did_not_declare():
    @dataclass(frozen=True)
    class Greedy(Diary):
        def plan(self, gbuffer, samples, state):
            return gbuffer.depth

    with pytest.raises(LookupError, match="'depth' was read but not declared"):
        list(run_clip(Greedy(Traits(inputs=frozenset({"albedo"}))), procedural(size=SIZE), 1.0))


def test_what_chose_the_samples_is_paid_for_but_not_shown_where_they_are_to_be_fresh():
    told = diary(Traits(passes=(0.25, 1.0), discard_pilot=True), 4.0, frames=1)
    assert told[-2:] == [("plan", 99, 0), ("denoise", 297, 0)]
    (shown,) = run_clip(
        Diary(Traits(passes=(0.25, 1.0), discard_pilot=True)), procedural(size=SIZE, frames=1), 4.0
    )
    assert int(shown.samples.counts.sum()) == 396


@dataclass(frozen=True)
class TowardsLight(Diary):
    """Looks where light is with a first sample, and averages."""

    def plan(self, gbuffer, samples, state):
        return samples.mean.mean(1, keepdim=True)


def biases(fresh: bool) -> torch.Tensor:
    """Percent of light too much in many noisy frames, after a pilot of one sample a pixel."""
    traits = Traits(adaptive=True, passes=(0.25, 1.0), min_samples=1, discard_pilot=fresh)
    clip = procedural(seed=3, size=Size(8, 40, 48), frames=3)
    shown = run_clip(TowardsLight(traits), clip, 4.0)
    return torch.cat([bias(each.image, each.frame.reference.mean) for each in shown])


def test_averaging_what_chose_the_samples_loses_light():
    found = biases(fresh=False)
    assert float(found.mean()) < -4 * float(found.std()) / len(found) ** 0.5


def test_fresh_samples_lose_none():
    found = biases(fresh=True)
    assert abs(float(found.mean())) < 4 * float(found.std()) / len(found) ** 0.5

"""The loop of rlbench/run.py: order of calls, passes, pilots, limits, and exact budgets."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
import torch

from metrics.image import bias
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import run_clip
from rlbench.sampling import BudgetError

SIZE = Size(1, 9, 11)


@dataclass(frozen=True)
class CallRecorder:
    """A method that records each call with its number of samples and its state."""

    traits: Traits = Traits()
    calls: list[tuple[str, int, object]] = field(default_factory=list)

    def start(self, size):
        self.calls.append(("start", size.h * size.w, None))
        return 0

    def plan(self, gbuffer, samples, state):
        self.calls.append(("plan", int(samples.counts.sum()), state))
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        self.calls.append(("denoise", int(samples.counts.sum()), state))
        return samples.mean, state + 1


def recorded_calls(traits: Traits, spp: float, frames: int = 2) -> list[tuple[str, int, object]]:
    method = CallRecorder(traits)
    list(run_clip(method, procedural_clip(size=SIZE, frames=frames), spp))
    return method.calls


def test_each_frame_is_planned_then_sampled_then_denoised():
    assert recorded_calls(Traits(), 2.0) == [
        ("start", 99, None),
        ("plan", 0, 0),
        ("denoise", 198, 0),
        ("plan", 0, 1),
        ("denoise", 198, 1),
    ]


def test_a_second_pass_sees_the_samples_of_the_first():
    assert recorded_calls(Traits(passes=(0.25, 1.0)), 4.0, frames=1) == [
        ("start", 99, None),
        ("plan", 0, 0),
        ("plan", 99, 0),
        ("denoise", 396, 0),
    ]


@pytest.mark.parametrize("spp", [0.0, 0.01, 0.5, 1.0, 3.3, 8.0])
def test_the_budget_is_spent_exactly(spp):
    *_, (_, sample_count, _) = recorded_calls(Traits(), spp, frames=1)
    assert sample_count == round(spp * 99)


@dataclass(frozen=True)
class Peaked(CallRecorder):
    """A method with nearly all of its density in one corner."""

    def plan(self, gbuffer, samples, state):
        return torch.arange(99.0).view(1, 1, 9, 11) ** 6


@pytest.mark.parametrize(
    ("share", "spp", "discard_pilot"),
    [
        (0.25, 2.0, False),
        (0.8, 1.25, False),
        (0.75, 2.0, False),
        (0.25, 1.0, False),
        (0.25, 2.0, True),
    ],
)
def test_the_minimum_holds_even_if_the_first_pass_cannot_pay_for_it(share, spp, discard_pilot):
    traits = Traits(adaptive=True, passes=(share, 1.0), min_samples=1, discard_pilot=discard_pilot)
    (result,) = run_clip(Peaked(traits), procedural_clip(size=SIZE, frames=1), spp)
    assert int(result.samples.counts.min()) >= 1
    assert int(result.samples.counts.sum()) == round(spp * 99)


@pytest.mark.parametrize("min_samples", [0, 1])
def test_the_minimum_holds_for_any_density(min_samples):
    clip = procedural_clip(size=SIZE, frames=1)
    (result,) = run_clip(Peaked(Traits(adaptive=True, min_samples=min_samples)), clip, 1.2)
    assert int(result.samples.counts.min()) == min_samples


def test_the_maximum_holds_and_the_rest_goes_to_other_pixels():
    clip = procedural_clip(size=SIZE, frames=1, pool_spp=16)
    (result,) = run_clip(Peaked(Traits(adaptive=True, max_samples=5)), clip, 2.0)
    assert int(result.samples.counts.max()) == 5
    assert int(result.samples.counts.sum()) == 2 * 99


def test_a_second_pass_keeps_the_samples_of_the_first():
    passed_samples = []

    @dataclass(frozen=True)
    class TwoPass(CallRecorder):
        def plan(self, gbuffer, samples, state):
            passed_samples.append(samples)
            return super().plan(gbuffer, samples, state)

    (result,) = run_clip(
        TwoPass(Traits(passes=(0.5, 1.0))), procedural_clip(size=SIZE, frames=1), 2.0
    )
    before = passed_samples[1]
    assert torch.equal(before.radiance, result.samples.radiance.where(before.valid_mask, 0.0))


def test_a_varying_density_must_be_declared():
    with pytest.raises(PluginError, match="declare Traits"):
        list(run_clip(Peaked(), procedural_clip(size=SIZE), 1.0))
    list(run_clip(Peaked(Traits(adaptive=True)), procedural_clip(size=SIZE), 1.0))


def test_a_nan_density_is_an_error():
    @dataclass(frozen=True)
    class Broken(CallRecorder):
        def plan(self, gbuffer, samples, state):
            return torch.full((1, 1, 9, 11), torch.nan)

    with pytest.raises(BudgetError, match="not finite"):
        list(run_clip(Broken(), procedural_clip(size=SIZE), 1.0))


def test_the_pilot_is_drawn_before_the_first_plan():
    assert recorded_calls(Traits(pilot_spp=1.0), 4.0, frames=1) == [
        ("start", 99, None),
        ("plan", 99, 0),
        ("denoise", 396, 0),
    ]


@pytest.mark.parametrize("spp", [0.5, 1.0])
def test_a_budget_up_to_the_pilot_is_uniform(spp):
    (result,) = run_clip(
        Peaked(Traits(adaptive=True, pilot_spp=1.0)), procedural_clip(size=SIZE, frames=1), spp
    )
    counts = result.samples.counts
    assert int(counts.sum()) == round(spp * 99)
    assert int(counts.max()) == 1


@pytest.mark.parametrize(
    ("discard_pilot", "min_samples", "pilot_spp", "spp", "passes"),
    [
        (False, 0, 0.5, 2.4, (0.25, 1.0)),
        (False, 1, 1.5, 4.0, (0.25, 0.375, 1.0)),
        (False, 2, 2.0, 8.0, (0.5, 1.0)),
        (True, 0, 1.0, 3.0, (0.25, 0.375, 1.0)),
        (True, 1, 0.5, 2.4, (0.5, 1.0)),
        (True, 1, 2.0, 8.0, (0.25, 1.0)),
        (True, 2, 1.5, 4.0, (0.5, 1.0)),
        (True, 2, 1.0, 3.0, (0.5, 1.0)),  # refused
    ],
)
def test_every_pilot_goes_with_all_passes(discard_pilot, min_samples, pilot_spp, spp, passes):
    traits = Traits(
        adaptive=True,
        pilot_spp=pilot_spp,
        passes=passes,
        min_samples=min_samples,
        discard_pilot=discard_pilot,
    )
    if reason := traits.unsupported_reason(spp):
        assert discard_pilot
        assert f"cannot pay for min_samples of {min_samples}" in reason
        with pytest.raises(BudgetError):
            next(run_clip(Peaked(traits), procedural_clip(size=SIZE, pool_spp=64), spp))
    else:
        result = next(run_clip(Peaked(traits), procedural_clip(size=SIZE, pool_spp=64), spp))
        assert int(result.samples.counts.sum()) == round(spp * 99)
        assert int(result.samples.counts.min()) >= min_samples


@pytest.mark.parametrize("spp", [0.5, 1.0, 1.5, 2.0])
def test_a_pass_that_ends_below_the_pilot_adds_no_samples(spp):
    calls = recorded_calls(Traits(pilot_spp=1.0, passes=(0.25, 1.0)), spp, frames=1)
    pilot, whole = round(min(spp, 1.0) * 99), round(spp * 99)
    assert calls[1:] == [("plan", pilot, 0), ("plan", pilot, 0), ("denoise", whole, 0)]


def test_a_budget_that_a_discarded_pilot_takes_from_the_minimum_is_refused():
    traits = Traits(adaptive=True, pilot_spp=1.0, discard_pilot=True, min_samples=1)
    reason = "discards 1 of 1 spp, and the 0 left cannot pay for min_samples of 1"
    assert traits.unsupported_reason(1.0) == reason
    assert traits.unsupported_reason(2.0) is None


def test_the_samples_after_a_pilot_include_it():
    (result,) = run_clip(
        Peaked(Traits(adaptive=True, pilot_spp=2.0)), procedural_clip(size=SIZE, frames=1), 3.0
    )
    assert int(result.samples.counts.min()) == 2
    assert int(result.samples.counts.sum()) == 297


PASSES = ((), (0.5,), (0.5, 0.5, 1.0), (1.0, 0.5), (0.0, 1.0), (2.0,))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        *(("pilot_spp", pilot, "must be 0 or more") for pilot in (-1.0, float("nan"))),
        *(("passes", each, "must increase from above 0 to exactly 1.0") for each in PASSES),
    ],
)
def test_a_negative_pilot_or_passes_that_do_not_end_at_the_budget_are_an_error(
    name, value, message
):
    with pytest.raises(ValueError, match=message):
        Traits(**{name: value})


def test_reading_an_undeclared_buffer_in_plan_is_an_error():
    @dataclass(frozen=True)
    class ReadsDepth(CallRecorder):
        def plan(self, gbuffer, samples, state):
            return gbuffer.depth

    with pytest.raises(LookupError, match="'depth' was read but not declared"):
        list(
            run_clip(
                ReadsDepth(Traits(inputs=frozenset({"albedo"}))), procedural_clip(size=SIZE), 1.0
            )
        )


def test_a_discarded_pilot_is_paid_for_but_not_denoised():
    calls = recorded_calls(Traits(passes=(0.25, 1.0), discard_pilot=True), 4.0, frames=1)
    assert calls[-2:] == [("plan", 99, 0), ("denoise", 297, 0)]
    (result,) = run_clip(
        CallRecorder(Traits(passes=(0.25, 1.0), discard_pilot=True)),
        procedural_clip(size=SIZE, frames=1),
        4.0,
    )
    assert int(result.samples.counts.sum()) == 396


@dataclass(frozen=True)
class TowardsRadiance(CallRecorder):
    """Samples in proportion to the radiance of the first samples, and averages."""

    def plan(self, gbuffer, samples, state):
        return samples.mean.mean(1, keepdim=True)


def biases(discard_pilot: bool) -> torch.Tensor:
    """Bias in percent of many noisy frames, after a pilot of one sample per pixel."""
    traits = Traits(adaptive=True, passes=(0.25, 1.0), min_samples=1, discard_pilot=discard_pilot)
    clip = procedural_clip(seed=3, size=Size(8, 40, 48), frames=3)
    results = run_clip(TowardsRadiance(traits), clip, 4.0)
    return torch.cat([bias(result.image, result.frame.reference.mean) for result in results])


def test_averaging_the_pilot_that_chose_the_samples_loses_light_and_discarding_it_does_not():
    averaged, discarded = biases(discard_pilot=False), biases(discard_pilot=True)
    assert float(averaged.mean()) < -4 * float(averaged.std()) / len(averaged) ** 0.5
    assert abs(float(discarded.mean())) < 4 * float(discarded.std()) / len(discarded) ** 0.5

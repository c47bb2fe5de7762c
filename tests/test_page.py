"""The loop of rlbench/run.py: order of calls, passes, pilots, limits, budgets, gradients."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
import torch

from metrics.image import bias
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import FrameResult, run_clip, unroll
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


@dataclass(frozen=True)
class Peaked(CallRecorder):
    """A method with nearly all of its density in one corner."""

    def plan(self, gbuffer, samples, state):
        return torch.arange(99.0).view(1, 1, 9, 11) ** 6


def run_first(method: CallRecorder, spp: float, pool_spp: int = 64) -> FrameResult:
    return next(run_clip(method, procedural_clip(size=SIZE, pool_spp=pool_spp), spp))


PILOT_AND_PASS = Traits(pilot_spp=1.0, passes=(0.25, 1.0))
CALLS = {  # traits, budget -> calls of the first frame with their numbers of samples
    "one pass": (Traits(), 2.0, [("plan", 0), ("denoise", 198)]),
    "a second pass sees the samples of the first": (
        Traits(passes=(0.25, 1.0)),
        4.0,
        [("plan", 0), ("plan", 99), ("denoise", 396)],
    ),
    "a pilot is drawn before the plan": (
        Traits(pilot_spp=1.0),
        4.0,
        [("plan", 99), ("denoise", 396)],
    ),
    "a discarded pilot is paid for but not denoised": (
        Traits(passes=(0.25, 1.0), discard_pilot=True),
        4.0,
        [("plan", 0), ("plan", 99), ("denoise", 297)],
    ),
    **{
        f"a pass below the pilot adds no samples, {spp} spp": (
            PILOT_AND_PASS,
            spp,
            [("plan", pilot), ("plan", pilot), ("denoise", round(spp * 99))],
        )
        for spp, pilot in ((0.5, 50), (1.5, 99), (2.0, 99))
    },
}


@pytest.mark.parametrize("case", CALLS)
def test_a_frame_is_planned_then_sampled_then_denoised(case):
    traits, spp, expected = CALLS[case]
    method = CallRecorder(traits)
    results = run_clip(method, procedural_clip(size=SIZE, frames=2), spp)
    assert [int(each.samples.counts.sum()) for each in results] == [round(spp * 99)] * 2
    states = [(*call, state) for state in (0, 1) for call in expected]
    assert method.calls == [("start", 99, None), *states]


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
    counts = run_first(Peaked(traits), spp, pool_spp=8).samples.counts
    assert int(counts.min()) >= 1
    assert int(counts.sum()) == round(spp * 99)


def test_the_maximum_holds_and_the_rest_goes_to_other_pixels():
    counts = run_first(Peaked(Traits(adaptive=True, max_samples=5)), 2.0).samples.counts
    assert int(counts.max()) == 5
    assert int(counts.sum()) == 2 * 99


def test_a_varying_density_must_be_declared():
    with pytest.raises(PluginError, match="declare Traits"):
        run_first(Peaked(), 1.0)
    run_first(Peaked(Traits(adaptive=True)), 1.0)


@pytest.mark.parametrize("spp", [0.5, 1.0])
def test_a_budget_up_to_the_pilot_is_uniform(spp):
    counts = run_first(Peaked(Traits(adaptive=True, pilot_spp=1.0)), spp).samples.counts
    assert int(counts.sum()) == round(spp * 99)
    assert int(counts.max()) == 1


def test_the_samples_after_a_pilot_include_it():
    counts = run_first(Peaked(Traits(adaptive=True, pilot_spp=2.0)), 3.0).samples.counts
    assert int(counts.min()) == 2
    assert int(counts.sum()) == 297


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
            run_first(Peaked(traits), spp)
    else:
        counts = run_first(Peaked(traits), spp).samples.counts
        assert int(counts.sum()) == round(spp * 99)
        assert int(counts.min()) >= min_samples


def test_a_budget_that_a_discarded_pilot_takes_from_the_minimum_is_refused():
    traits = Traits(adaptive=True, pilot_spp=1.0, discard_pilot=True, min_samples=1)
    reason = "discards 1 of 1 spp, and the 0 left cannot pay for min_samples of 1"
    assert traits.unsupported_reason(1.0) == reason
    assert traits.unsupported_reason(2.0) is None


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        *(("pilot_spp", pilot, "must be 0 or more") for pilot in (-1.0, float("nan"))),
        ("receptive_field", -1, "receptive_field is -1"),
        *(
            ("passes", passes, "must increase from above 0 to exactly 1.0")
            for passes in ((), (0.5,), (0.5, 0.5, 1.0), (1.0, 0.5), (0.0, 1.0))
        ),
    ],
)
def test_traits_that_contradict_themselves_are_an_error(name, value, message):
    with pytest.raises(ValueError, match=message):
        Traits(**{name: value})


def test_reading_an_undeclared_buffer_in_plan_is_an_error():
    @dataclass(frozen=True)
    class ReadsDepth(CallRecorder):
        def plan(self, gbuffer, samples, state):
            return gbuffer.depth

    with pytest.raises(LookupError, match="'depth' was read but not declared"):
        run_first(ReadsDepth(Traits(inputs=frozenset({"albedo"}))), 1.0)


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


@pytest.mark.parametrize(("run", "has_gradient"), [(unroll, True), (run_clip, False)])
def test_only_unroll_keeps_gradients(run, has_gradient):
    weight = torch.ones((), requires_grad=True)

    @dataclass(frozen=True)
    class Scaled(CallRecorder):
        def denoise(self, gbuffer, samples, state):
            return samples.mean * weight, state

    result = next(iter(run(Scaled(), procedural_clip(size=SIZE, frames=1), 1.0)))
    assert result.image.requires_grad is has_gradient


def test_interleaved_runs_do_not_change_the_gradient_mode():
    clips = [procedural_clip(seed, SIZE, frames=2) for seed in (0, 1)]
    for _ in zip(*(run_clip(CallRecorder(), clip, 1.0) for clip in clips), strict=True):
        assert not torch.is_inference_mode_enabled()
    assert not torch.is_inference_mode_enabled()

"""The section on bad pixels: it passes a mean, and catches planted faults of toy methods."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
import torch
from torch.nn import functional as F

from rlbench.checks.result import Verdict
from rlbench.checks.stress import bad_pixel
from rlbench.checks.stress.blast import Blast, compare_frames
from rlbench.checks.stress.faults import VALUES, plant_in_state
from rlbench.checks.stress.section import StressedMethod
from rlbench.family import Traits
from rlbench.frames import Size

CPU = torch.device("cpu")
PASSED, WARNING, FAILED = Verdict.PASSED, Verdict.WARNING, Verdict.FAILED


@dataclass(frozen=True)
class Mean:
    """The mean of the samples: a bad sample changes its own pixel."""

    traits: Traits = Traits()

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer, samples, state):
        return samples.mean, None


@dataclass(frozen=True)
class ExposedByMaximum(Mean):
    """The brightest sample sets the exposure of the whole image."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean / samples.mean.amax((1, 2, 3), keepdim=True), None


@dataclass(frozen=True)
class WideBlur(Mean):
    """A bad sample is spread over 25 x 25 pixels, for one frame."""

    def denoise(self, gbuffer, samples, state):
        return F.avg_pool2d(samples.mean, 25, 1, 12), None


@dataclass(frozen=True)
class Accumulating(Mean):
    """An exponential average that never looks at what it keeps."""

    traits: Traits = Traits(inputs=frozenset({"motion"}), temporal=True)

    def start(self, size):
        return torch.zeros(size.n, 3, size.h, size.w)

    def denoise(self, gbuffer, samples, state):
        image = torch.lerp(state, samples.mean, 0.5)
        return image, image


@dataclass(frozen=True)
class DividingByDepth(Mean):
    """A depth is used as a divisor of a sum over the image."""

    traits: Traits = Traits(inputs=frozenset({"depth"}))

    def denoise(self, gbuffer, samples, state):
        return samples.mean * gbuffer.depth.nan_to_num(posinf=0).mean(), None


@dataclass(frozen=True)
class AvoidsTheBrightest(Mean):
    """After a very bright sample the left half of the image gets no samples."""

    traits: Traits = Traits(adaptive=True, temporal=True)

    def start(self, size):
        return torch.ones(size.n, 1, size.h, size.w)

    def plan(self, gbuffer, samples, state):
        return state

    def denoise(self, gbuffer, samples, state):
        density = torch.ones_like(state)
        if samples.mean.amax() > 2e4:
            density[..., : density.shape[-1] // 2] = 0
        return samples.mean, density


def verdicts(method) -> dict[str, Verdict]:
    results = bad_pixel.run(StressedMethod("toy", method, CPU), quick=False)
    return {result.test: result.verdict for result in results}


def test_a_mean_contains_every_fault_and_needs_the_suite_for_two_of_three():
    found = verdicts(Mean())
    assert found.pop("unsanitized") is WARNING
    assert found == {f"sample-{value}": PASSED for value in VALUES}


def test_an_exposure_that_one_pixel_moves_is_caught():
    found = verdicts(ExposedByMaximum())
    assert found["sample-1e30"] is found["sample-65504"] is WARNING
    assert found["sample-nan"] is PASSED  # black


def test_a_fault_that_spreads_for_one_frame_is_degraded_and_not_failed():
    assert verdicts(WideBlur())["sample-1e5"] is WARNING


def test_a_state_that_keeps_bad_values_fails():
    found = verdicts(Accumulating())
    assert found["state-nan"] is found["state-inf"] is FAILED
    assert PASSED not in (found["state-1e30"], found["sample-65504"])  # visible


def test_a_buffer_that_moves_the_whole_image_is_caught():
    assert verdicts(DividingByDepth())["depth-1e30"] is WARNING
    assert verdicts(DividingByDepth())["depth-minus-one"] is PASSED  # repaired by the core


def test_a_fault_that_moves_samples_is_seen_with_free_counts_alone():
    found = verdicts(AvoidsTheBrightest())
    assert found["sample-65504"] is PASSED
    assert found["sample-65504-free"] is FAILED


def test_an_exception_is_a_failure_that_names_it():
    @dataclass(frozen=True)
    class Raises(Mean):
        def denoise(self, gbuffer, samples, state):
            if samples.radiance.amax() > 6e4:
                raise ArithmeticError("too bright")
            return samples.mean, None

    results = bad_pixel.run(StressedMethod("toy", Raises(), CPU), quick=True)
    (failed,) = (result for result in results if result.verdict is FAILED)
    assert failed.test == "sample-65504"
    assert "ArithmeticError: too bright" in failed.found


def test_every_test_that_did_not_pass_says_what_to_do():
    results = bad_pixel.run(StressedMethod("toy", Accumulating(), CPU), quick=True)
    assert all(bool(result.remedy) != (result.verdict is PASSED) for result in results)


# Blast radius


def test_the_figures_of_a_blast_are_those_of_a_planted_change():
    clean = torch.full((1, 3, 40, 50), 0.5)
    image = clean.clone()
    image[..., 20, 25] = image[..., 20, 37] = 0.6
    image[..., 0, 0] = math.nan
    blast = compare_frames(image, clean, clean, 20, 25)
    assert (blast.changed_pixels, blast.nonfinite) == (3, 1)
    assert blast.distance == pytest.approx(math.hypot(20, 25))
    assert blast.largest == pytest.approx(0.6)
    # outside 8 pixels: 0.060 in one pixel and 1 in another, of about 2000 - 197
    assert blast.psnr_outside == pytest.approx(10 * math.log10(1803), abs=0.05)


def test_a_blast_is_clean_after_its_last_changed_frame():
    clean = torch.zeros(1, 3, 20, 20)
    bad = clean.clone()
    bad[..., 5, 5] = 1.0
    same, other = compare_frames(clean, clean, clean, 5, 5), compare_frames(bad, clean, clean, 5, 5)
    assert Blast([same]).frames_until_clean == 0
    assert Blast([other, same, other, same]).frames_until_clean == 3
    assert Blast([other, other]).frames_until_clean == math.inf
    assert not Blast([other] * 7).is_contained()
    assert Blast([other] * 7).is_contained(legal=Blast([other] * 7))


def test_a_planted_state_leaves_the_original_and_small_tensors_unchanged():
    state = {"image": torch.zeros(1, 2, 4, 6), "row": torch.zeros(3, 40), "age": torch.zeros(1)}
    planted, count = plant_in_state(state, math.nan, Size(1, 4, 6), 1, 2)
    assert count == 2
    assert planted["image"].isnan().nonzero().tolist() == [[0, 0, 1, 2], [0, 1, 1, 2]]
    assert planted["row"].isnan().nonzero().tolist() == [[0, 23], [1, 23], [2, 23]]
    assert not planted["age"].isnan().any()
    assert not state["image"].isnan().any()

"""The section on bad pixels: it passes a mean, and catches planted faults of toy methods."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.checks.result import Verdict
from rlbench.checks.stress import bad_pixel
from rlbench.checks.stress.bad_pixel import VALUES, Blast, compare_frames, plant_in_state
from rlbench.frames import Size
from tests.checks.stress import broken_methods as broken
from tests.checks.stress.broken_methods import STATELESS

PASSED, WARNING, FAILED = Verdict.PASSED, Verdict.WARNING, Verdict.FAILED


def verdicts(method):
    return broken.verdicts(bad_pixel, method, is_quick=False)


def test_a_mean_contains_every_fault_and_needs_the_suite_for_two_of_three():
    found = verdicts(broken.Mean())
    assert found.pop("unsanitized") is WARNING
    assert found == {f"sample-{value}": PASSED for value in VALUES}


def test_an_exposure_that_one_pixel_moves_is_caught():
    found = verdicts(STATELESS["ExposedByMaximum"])
    assert found["sample-1e30"] is found["sample-65504"] is WARNING
    assert found["sample-nan"] is PASSED  # black


def test_a_fault_that_spreads_for_one_frame_is_degraded_and_not_failed():
    assert verdicts(STATELESS["WideBlur"])["sample-1e5"] is WARNING


def test_a_state_that_keeps_bad_values_fails():
    found = verdicts(broken.AveragesBlindly())
    assert found["state-nan"] is found["state-inf"] is FAILED
    assert PASSED not in (found["state-1e30"], found["sample-65504"])  # visible


def test_a_buffer_that_moves_the_whole_image_is_caught():
    found = verdicts(STATELESS["DividingByDepth"])
    assert found["depth-1e30"] is WARNING
    assert found["depth-minus-one"] is PASSED  # repaired by the core


def test_a_fault_that_moves_samples_is_seen_with_free_counts_alone():
    found = verdicts(broken.AvoidsTheBrightest())
    assert found["sample-65504"] is PASSED
    assert found["sample-65504-free"] is FAILED


def test_an_exception_is_a_failure_that_names_it():
    results = broken.run_section(bad_pixel, broken.RejectsBright()).values()
    (failed,) = (result for result in results if result.verdict is FAILED)
    assert failed.check == "sample-65504"
    assert "ArithmeticError: too bright" in failed.found


def test_every_test_that_did_not_pass_says_what_to_do():
    results = broken.run_section(bad_pixel, broken.AveragesBlindly()).values()
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

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
FAULTS = [  # a method, and verdicts that it gets
    (
        STATELESS["ExposedByMaximum"],
        {"sample-1e30": WARNING, "sample-65504": WARNING, "sample-nan": PASSED},  # NaN is black
    ),
    (STATELESS["WideBlur"], {"sample-1e5": WARNING}),  # for one frame
    (
        STATELESS["DividingByDepth"],
        {"depth-1e30": WARNING, "depth-minus-one": PASSED},  # which the core repairs
    ),
    (
        broken.AveragesBlindly(),
        dict.fromkeys(("state-nan", "state-inf", "state-1e30", "sample-65504"), FAILED),
    ),
    (broken.AvoidsTheBrightest(), {"sample-65504": PASSED, "sample-65504-free": FAILED}),
]


def stress(method):
    return broken.run_section(bad_pixel, method, is_quick=False)


def test_a_mean_contains_every_fault_and_needs_the_suite_for_two_of_three():
    found = {test: result.verdict for test, result in stress(broken.Mean()).items()}
    assert found == {f"sample-{value}": PASSED for value in VALUES} | {"unsanitized": WARNING}


@pytest.mark.parametrize(("method", "verdicts"), FAULTS)
def test_a_fault_is_caught(method, verdicts):
    results = stress(method)
    assert {test: results[test].verdict for test in verdicts} == verdicts
    assert all(bool(result.remedy) != (result.verdict is PASSED) for result in results.values())


def test_an_exception_is_a_failure_that_names_it():
    results = broken.run_section(bad_pixel, STATELESS["RejectsBright"]).values()
    (failed,) = (result for result in results if result.verdict is FAILED)
    assert failed.check == "sample-65504"
    assert "ArithmeticError: too bright" in failed.found


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

"""What a metric is handed: derived images are computed once, and a chain of frames is cut."""

from __future__ import annotations

import math
from collections import Counter

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from metrics import effort, image, ssim, temporal
from metrics.comparison import MAX_PREVIOUS, Comparison
from metrics.ground_truth import GroundTruth
from metrics.metric import Metric
from rlbench import registry


def comparison(value=0.5, previous=None, **given):
    half = torch.full((1, 3, 4, 5), 0.3)
    return Comparison.of(torch.full_like(half, value), half, half + 0.2, previous=previous, **given)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_nonfinite_pixel_is_displayed_as_far_from_the_reference_as_possible(value):
    half = torch.tensor([0.9, 0.1, 0.9]).view(1, 3, 1, 1).repeat(1, 1, 2, 2)
    image = half.clone()
    image[0, 1, 0, 0] = value  # one channel invalidates the pixel
    frame = Comparison.of(image, half, half)
    assert frame.display_image[0, :, 0, 0].tolist() == [0, 1, 0]
    assert frame.nonfinite_mask.flatten().tolist() == [True, False, False, False]


def test_two_frames_before_keep_what_they_computed_and_older_ones_are_forgotten():
    first = comparison()
    second = comparison(previous=first)
    encoded, change = second.display_image, second.change_of_error
    third = comparison(previous=second)
    assert third.previous is second
    assert third.previous.previous is first
    fourth = comparison(previous=third)
    assert fourth.frames_before == MAX_PREVIOUS == 2
    assert fourth.previous.previous.display_image is encoded
    assert fourth.previous.previous.change_of_error is change


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"previous_frames": MAX_PREVIOUS + 1}, "previous_frames=3"),
        ({"whole_clip": True}, "give it scored_by_run=False"),
    ],
)
def test_a_metric_that_no_run_could_score_is_an_error(options, words):
    with pytest.raises(ValueError, match=words):
        Metric("vdp", "JOD", "higher", "four frames", lambda c: c.image, **options)


@pytest.mark.parametrize(
    ("given", "known"),
    [
        ({}, set()),
        ({"static": True}, {"motion"}),
        ({"motion": torch.zeros(1, 2, 4, 5)}, {"motion"}),
        ({"counts": torch.ones(1, 1, 4, 5)}, {"counts"}),
        ({"max_samples": 8}, {"max_samples"}),
    ],
)
def test_a_comparison_says_what_it_has(given, known):
    frame = comparison(**given)
    assert {name for name in ("counts", "max_samples", "motion") if frame.has(name)} == known


class DisplayCurves(TorchDispatchMode):
    """Counts how often an image goes through the curve of sRGB, whose power is 1 / 2.4."""

    count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.count += func is torch.ops.aten.pow.Tensor_Scalar and args[1] == 1 / 2.4
        return func(*args, **kwargs or {})


def score_all(frame, size):
    for metric in registry.load_run_metrics().values():
        if metric.previous_frames <= frame.frames_before and all(map(frame.has, metric.needs)):
            metric.at(*size).score(frame)


def count_calls(monkeypatch, module, name, calls):
    function = getattr(module, name)

    def call(*args):
        calls[name] += 1
        return function(*args)

    monkeypatch.setattr(module, name, call)


def test_all_metrics_of_a_frame_share_what_they_derive_from_it(monkeypatch):
    calls = Counter()
    count_calls(monkeypatch, image, "bound_radiance", calls)
    count_calls(monkeypatch, ssim, "similarity_terms", calls)
    half = torch.rand(1, 3, 176, 176, generator=torch.Generator().manual_seed(0))
    counts = torch.arange(176).expand(1, 1, 176, 176)
    given = {"counts": counts, "static": True, "max_samples": 8}
    frame = Comparison.of(half / 2, half, half + 0.1, **given)
    with DisplayCurves() as curves:
        score_all(frame, (176, 176))
    assert curves.count == 4  # image, reference, and its two halves
    assert calls == {"bound_radiance": 4, "similarity_terms": 5}  # the five scales of MS-SSIM


def test_images_with_one_ground_truth_share_what_depends_on_the_reference_alone(monkeypatch):
    calls = Counter()
    for module, name in [
        (ssim, "reference_windows"),
        (effort, "scene_noise"),
        (temporal, "locate_previous"),
    ]:
        count_calls(monkeypatch, module, name, calls)
    half = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    counts = torch.arange(32).expand(1, 1, 32, 32)
    truth = GroundTruth(half, half + 0.1, motion=torch.full((1, 2, 32, 32), 0.5))
    with DisplayCurves() as curves:
        for brightness in (0.5, 0.7, 0.9):
            before = Comparison(half, truth, counts=counts)
            frame = Comparison(half * brightness, truth, counts=counts, previous=before)
            score_all(frame, (32, 32))
    assert curves.count == 3 + 6  # the reference and its halves, and the images
    assert calls == {"reference_windows": 1, "scene_noise": 1, "locate_previous": 1}


def test_a_reference_in_place_of_a_ground_truth_is_an_error_that_says_what_to_write():
    half = torch.zeros(1, 3, 4, 5)
    with pytest.raises(TypeError, match=r"Comparison\.of\(image, half_a, half_b\)"):
        Comparison(half, half)

"""What a metric is handed: derived images are computed once, and a chain of frames is cut."""

from __future__ import annotations

import math

import pytest
import torch

from metrics.metric import Comparison, Metric


def comparison(value=0.5, previous=None, **given):
    half = torch.full((1, 3, 4, 5), 0.3)
    return Comparison(torch.full_like(half, value), half, half + 0.2, previous=previous, **given)


def test_derived_images_are_computed_once():
    frame = comparison()
    assert frame.display_image is frame.display_image
    assert frame.reference is frame.reference
    assert frame.reference.unique().tolist() == pytest.approx([0.4])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_nonfinite_pixel_is_displayed_as_far_from_the_reference_as_possible(value):
    half = torch.tensor([0.9, 0.1, 0.9]).view(1, 3, 1, 1).repeat(1, 1, 2, 2)
    image = half.clone()
    image[0, 1, 0, 0] = value  # one channel invalidates the pixel
    frame = Comparison(image, half, half)
    assert frame.display_image[0, :, 0, 0].tolist() == [0, 1, 0]
    assert frame.nonfinite_mask.flatten().tolist() == [True, False, False, False]


def test_a_previous_frame_keeps_its_images_and_forgets_the_frame_before_it():
    first = comparison()
    second = comparison(previous=first)
    encoded = second.display_image
    third = comparison(previous=second)
    assert second.previous is first
    assert third.previous.previous is None
    assert third.previous.display_image is encoded


@pytest.mark.parametrize(
    ("given", "known"),
    [
        ({}, set()),
        ({"static": True}, {"motion"}),
        ({"motion": torch.zeros(1, 2, 4, 5)}, {"motion"}),
        ({"counts": torch.ones(1, 1, 4, 5)}, {"counts"}),
    ],
)
def test_a_comparison_says_what_it_has(given, known):
    frame = comparison(**given)
    assert {name for name in ("counts", "motion") if frame.has(name)} == known


def test_a_metric_of_whole_clips_cannot_be_scored_by_a_run():
    with pytest.raises(ValueError, match="give it scored_by_run=False"):
        Metric("vdp", "JOD", "higher", "all frames", lambda frames: 0.0, whole_clip=True)

"""Every installed metric that judges an image takes a pixel that is not finite for its worst."""

from __future__ import annotations

import math
from importlib.metadata import entry_points

import pytest
import torch

METRICS = [entry.load() for entry in entry_points(group="rlbench.metrics")]
JUDGING = [m for m in METRICS if "counts" not in m.needs and m.scored_by_run]
SIZE = (1, 3, 165, 170)  # MS-SSIM needs sides above 160 pixels
PIXEL = (..., 80, 90)


def judge(metric, last_pixel):
    """Error of a grey clip whose last frame has one pixel of this radiance; larger is worse."""
    frame = None
    for index in range(3):
        halves = torch.rand(2, *SIZE, generator=torch.Generator().manual_seed(index)) * 0.4
        image = halves.mean(0)
        if index == 2:
            image[PIXEL] = last_pixel
        frame = metric.compare(image, *halves, static=True, previous=frame)
    score = metric.at(*SIZE[2:]).score(frame).item()
    assert math.isfinite(score)
    return {"higher": -score, "lower": score, "": abs(score)}[metric.direction]


@pytest.mark.parametrize("metric", JUDGING, ids=lambda m: m.name)
def test_a_nonfinite_pixel_is_at_least_as_bad_as_any_displayable_one(metric):
    worst_displayable = max(judge(metric, value) for value in (0.0, 0.1, 0.5, 1.0))
    for value in (math.nan, math.inf, -math.inf):
        assert judge(metric, value) >= worst_displayable


def test_a_metric_of_effort_judges_no_image_and_has_no_direction():
    assert {m.direction for m in METRICS if "counts" in m.needs} == {""}

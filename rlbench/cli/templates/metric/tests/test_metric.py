"""The metric gives what is computed by hand, and a finite number for any image."""

from __future__ import annotations

import math
from importlib import import_module

import pytest
import torch

metric = import_module("$name.metric").WORST_PIXEL
GREY = torch.full((1, 3, 4, 5), 0.5)


def score(image: torch.Tensor) -> float:
    return float(metric.score(metric.compare(image, GREY, GREY)))


def test_one_wrong_pixel_decides() -> None:
    image = GREY.clone()
    image[0, 1, 2, 3] = 0.75
    assert score(image) == 0.25


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_the_score_is_finite_where_the_image_is_not(value: float) -> None:
    image = GREY.clone()
    image[0, 1, 2, 3] = value
    assert score(image) == pytest.approx(6e4, rel=1e-3)

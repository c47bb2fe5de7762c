"""Sanitising: every invalid value is replaced, every valid one stays, and history is repaired."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rlbench.ops.sanitize import (
    RULES,
    repair_history,
    sanitize_albedo,
    sanitize_depth,
    sanitize_motion,
    sanitize_normal,
    sanitize_radiance,
)
from rlbench.ops.transfer import HALF_MAX

NAN, INF = math.nan, math.inf
CHANNELS = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2}
BAD = st.sampled_from([NAN, INF, -INF, 1e30, -1e30, 65504.0, 1e5, -1.0, 1e-40, 0.0, 0.5])


def pixel(*values: float) -> torch.Tensor:
    return torch.tensor(values).view(1, -1, 1, 1)


def row(*values: float) -> torch.Tensor:
    """One channel, one line of pixels."""
    return torch.tensor(values).view(1, 1, 1, -1)


@pytest.mark.parametrize(
    ("radiance", "expected"),
    [
        ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0)),
        ((-1.0, 2.0, 1e30), (0.0, 2.0, 65504.0)),
        ((NAN, 2.0, 3.0), (0.0, 0.0, 0.0)),
        ((INF, 2.0, 3.0), (0.0, 0.0, 0.0)),
    ],
    ids=["usual", "out of range", "nan", "infinite"],
)
def test_radiance_becomes_finite_and_nonfinite_pixels_black(radiance, expected):
    assert torch.equal(sanitize_radiance(pixel(*radiance)), pixel(*expected))


def is_valid(name: str, buffer: torch.Tensor) -> bool:
    if name == "albedo":
        return bool(((buffer >= 0) & (buffer <= 1)).all())
    if name == "normal":
        return bool((buffer.square().sum(1) < 1.03).all())
    if name == "depth":
        return bool((buffer > 0).all())
    return bool(buffer.isfinite().all())


@pytest.mark.parametrize("name", list(RULES))
@settings(max_examples=60)
@given(data=st.data())
def test_whatever_a_renderer_writes_becomes_valid(name, data):
    h, w = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    count = CHANNELS[name] * h * w
    values = data.draw(st.lists(BAD, min_size=count, max_size=count))
    assert is_valid(name, RULES[name](torch.tensor(values).view(1, -1, h, w)))


@pytest.mark.parametrize("name", list(RULES))
def test_a_valid_buffer_is_returned_without_a_copy(name):
    buffer = torch.rand(1, CHANNELS[name], 4, 5) * 0.5 + 0.01
    assert RULES[name](buffer) is buffer


@pytest.mark.parametrize("value", [NAN, INF, -1.0, 1e30, 65504.0])
def test_invalid_albedo_is_a_neighbours(value):
    albedo = torch.full((1, 3, 3, 3), 0.25)
    albedo[..., 1, 1] = value
    assert (sanitize_albedo(albedo) == 0.25).all()


def test_albedo_a_little_above_one_is_clamped():
    assert sanitize_albedo(pixel(1.2, 0.5, -0.1)).flatten().tolist() == [1.0, 0.5, 0.0]


def test_a_long_normal_keeps_its_direction_and_a_short_one_its_length():
    assert torch.allclose(sanitize_normal(pixel(0.0, 0.9, 1.2)), pixel(0.0, 0.6, 0.8))
    assert torch.equal(sanitize_normal(pixel(0.0, 0.3, 0.4)), pixel(0.0, 0.3, 0.4))


@pytest.mark.parametrize("value", [NAN, -1.0, 0.0, -INF, 1e-40])
def test_invalid_depth_is_a_neighbours_and_background_stays(value):
    assert sanitize_depth(row(INF, 2.0, value)).flatten().tolist() == [INF, 2.0, 2.0]


def test_a_pixel_without_a_valid_neighbour_gets_the_fallback():
    assert not sanitize_albedo(torch.full((1, 3, 3, 3), NAN)).any()
    outside = sanitize_motion(torch.full((1, 2, 4, 5), NAN))
    assert (outside >= 5).all()


@pytest.mark.parametrize("value", [NAN, INF, -0.5, 2.0])
def test_history_outside_its_range_is_a_neighbours_and_within_it_is_returned(value):
    history = row(0.5, value, 0.25)
    assert repair_history(history, 0.0, 1.0).flatten().tolist() == [0.5, 0.5, 0.25]
    valid = row(0.0, 1.0, HALF_MAX)
    assert repair_history(valid, 0.0, HALF_MAX) is valid

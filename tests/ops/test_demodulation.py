"""Demodulation: bounds of the divisor, filtered albedo, surface mask, sanitized radiance."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from rlbench.ops.demodulation import (
    demodulation_albedo,
    filtered_albedo,
    reflectance,
    surface_mask,
)
from tests.baselines.wavelet_twins import area_albedo


def pixel(*values: float) -> torch.Tensor:
    return torch.tensor(values).view(1, -1, 1, 1)


def test_reflectance_is_clamped_away_from_zero():
    assert torch.equal(reflectance(pixel(0.0, 0.5, 2.0)), pixel(1e-3, 0.5, 1.0))


def test_reflectance_is_the_mean_albedo_of_the_pixel_area():
    albedo = torch.rand(2, 3, 9, 11, generator=torch.Generator().manual_seed(0))
    albedo[:, :, 3:6, 2:4] = 0  # an emitter
    slow = [area_albedo(one.permute(1, 2, 0).double().numpy()) for one in albedo]
    expected = torch.from_numpy(np.stack(slow)).permute(0, 3, 1, 2).float()
    torch.testing.assert_close(reflectance(albedo), expected)  # float32 sums
    black = (albedo == 0).all(1, keepdim=True).expand_as(albedo)
    torch.testing.assert_close(
        demodulation_albedo(filtered_albedo(albedo)), torch.where(black, 1.0, expected) + 0.01
    )
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(reflectance(albedo), reflectance(albedo).float())
        torch.testing.assert_close(reflectance(albedo), expected)


@pytest.mark.parametrize(
    ("albedo", "depth", "expected"),
    [
        ((0.5, 0.5, 0.5), 3.0, True),
        ((0.0, 0.1, 0.0), 3.0, True),
        ((0.0, 0.0, 0.0), 3.0, False),
        ((0.5, 0.5, 0.5), math.inf, False),
    ],
    ids=["grey", "green", "emitter", "background"],
)
def test_a_surface_has_finite_depth_and_non_zero_albedo(albedo, depth, expected):
    assert bool(surface_mask(pixel(*albedo), pixel(depth))) is expected

"""Firefly limit: one outlier gets the mean of its window; usual light is left alone."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.ops.color import luminance
from rlbench.ops.fireflies import CONTRAST, limit_fireflies, limit_sample_fireflies


def noisy(side: int = 16, seed: int = 0) -> torch.Tensor:
    """Exponential noise: its largest neighbour is within a factor of 64."""
    generator = torch.Generator().manual_seed(seed)
    return -torch.rand(1, 3, side, side, generator=generator).clamp_min(1e-6).log()


def limit_slowly(radiance: torch.Tensor, average: float) -> torch.Tensor:
    """Pixel by pixel."""
    light, result = luminance(radiance)[0, 0], radiance.clone()
    h, w = light.shape
    for y in range(h):
        for x in range(w):
            window = [
                (yy, xx)
                for yy in range(max(y - 2, 0), min(y + 3, h))
                for xx in range(max(x - 2, 0), min(x + 3, w))
            ]
            brightest = [max(_others(light, window, p)) for p in window]
            brightest = [max(value, average) for value in brightest]
            here = window.index((y, x))
            if light[y, x] > CONTRAST * brightest[here]:
                # each pixel of the window counts up to the brightest of its own neighbours
                limits = _limits(light, window, average)
                mean = sum(min(float(light[p]), m) for p, m in zip(window, limits, strict=True))
                result[0, :, y, x] *= mean / len(window) / light[y, x]
    return result


def _others(light, window, pixel):
    return [float(light[p]) for p in window if p != pixel]


def _limits(light, window, average):
    h, w = light.shape
    limits = []
    for y, x in window:
        others = [
            float(light[yy, xx])
            for yy in range(max(y - 2, 0), min(y + 3, h))
            for xx in range(max(x - 2, 0), min(x + 3, w))
            if (yy, xx) != (y, x)
        ]
        limits.append(max(*others, average))
    return limits


@pytest.mark.parametrize("pixel", [(8, 8), (0, 0), (15, 3)])
def test_an_outlier_is_replaced_as_by_a_slow_twin(pixel):
    from rlbench.ops.exposure import MIDDLE_GREY, autoexposure

    radiance = noisy()
    radiance[..., pixel[0], pixel[1]] = torch.tensor([65504.0, 1000.0, 10.0])
    average = float(MIDDLE_GREY / autoexposure(radiance))
    limited = limit_fireflies(radiance)
    assert not torch.equal(limited, radiance)
    assert torch.allclose(limited, limit_slowly(radiance, average), rtol=1e-4)


def test_usual_noise_and_two_bright_pixels_side_by_side_stay():
    radiance = noisy()
    radiance[..., 8, 8:10] = 1000.0
    assert limit_fireflies(radiance) is radiance


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_invalid_values_become_black(value):
    radiance = noisy()
    radiance[..., 3, 4] = value
    assert (limit_fireflies(radiance)[..., 3, 4] == 0).all()


@pytest.mark.parametrize("exposure", [1e-4, 1e2])
def test_the_limit_follows_the_exposure(exposure):
    """With a lamp of 300 in light of 1, which a fixed cap would cut at one exposure only."""
    radiance = noisy()
    radiance[..., 8, 8] = 300.0
    limited = limit_fireflies(radiance * exposure) / exposure
    assert torch.allclose(limited, limit_fireflies(radiance), rtol=1e-4)


def test_one_sample_is_limited_and_the_others_of_its_pixel_stay():
    radiance = torch.stack([noisy(seed=s)[0] for s in range(3)])[None]
    bad = radiance.clone()
    bad[0, 1, :, 8, 8] = 65504.0
    counts = torch.full((1, 1, 16, 16), 3)
    limited = limit_sample_fireflies(bad, counts)
    assert luminance(limited[0, 1, :, 8, 8, None, None]).item() < 5
    limited[0, 1, :, 8, 8] = radiance[0, 1, :, 8, 8]
    assert torch.equal(limited, radiance)

"""Fireflies: one outlier gets the mean of its window; usual light is left alone."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.color import luminance
from rlbench.ops.exposure import MIDDLE_GREY, autoexposure
from rlbench.ops.fireflies import (
    CONTRAST,
    FALLOFF,
    MAX_RADIUS,
    NO_PIXEL,
    _window_radius,
    limit_fireflies,
    mean_without_fireflies,
    repair_light,
    repair_radiance_history,
)
from rlbench.ops.windows import max_of_neighbours

SIDE, SPP = 16, 3
COUNTS = torch.full((1, 1, SIDE, SIDE), SPP)


def noisy(seed: int = 0) -> Tensor:
    """Three samples per pixel of exponential noise: no mean is 64 times its neighbours."""
    generator = torch.Generator().manual_seed(seed)
    return -torch.rand(1, SPP, 3, SIDE, SIDE, generator=generator).clamp_min(1e-6).log()


def window(y: int, x: int) -> list[tuple[int, int]]:
    rows, columns = range(max(y - 2, 0), min(y + 3, SIDE)), range(max(x - 2, 0), min(x + 3, SIDE))
    return [(row, column) for row in rows for column in columns]


def limit_slowly(radiance: Tensor) -> Tensor:
    """Pixel by pixel and sample by sample."""
    mean, result = radiance.mean(1), radiance.clone()
    light = luminance(mean)[0, 0]

    def others(y: int, x: int) -> float:
        return max(float(light[p]) for p in window(y, x) if p != (y, x))

    # the image's average, in which an outlier counts as much as its brightest neighbour
    plausible = [min(float(light[y, x]), others(y, x)) for y in range(SIDE) for x in range(SIDE)]
    image = torch.tensor(plausible).view(1, 1, SIDE, SIDE).expand(1, 3, SIDE, SIDE)
    average = float(MIDDLE_GREY / autoexposure(image))

    def brightest(y: int, x: int) -> float:
        return max(average, others(y, x))

    for y in range(SIDE):
        for x in range(SIDE):
            limited = [min(float(light[p]), brightest(*p)) for p in window(y, x)]
            for slot in range(SPP):
                value = float(luminance(radiance[0, slot])[0, y, x])
                limit, mean_around = CONTRAST * brightest(y, x), sum(limited) / len(limited)
                if value > limit:
                    dimmed = mean_around + (limit - mean_around) * (limit / value) ** FALLOFF
                    result[0, slot, :, y, x] *= dimmed / value
    return result


@pytest.mark.parametrize("pixel", [(8, 8), (0, 0), (15, 3)])
def test_an_outlier_is_replaced_as_by_a_slow_twin(pixel):
    radiance = noisy()
    radiance[:, 1, :, pixel[0], pixel[1]] = torch.tensor([65504.0, 1000.0, 10.0])
    limited = limit_fireflies(radiance, COUNTS)
    assert not torch.equal(limited, radiance)
    assert torch.allclose(limited, limit_slowly(radiance), rtol=1e-4)
    assert torch.allclose(mean_without_fireflies(radiance, COUNTS), limited.mean(1))


@pytest.mark.parametrize(("excess", "left"), [(1.0001, 1 - 4e-4), (2.0, 1 / 16)])
def test_an_outlier_is_dimmed_by_the_fourth_power_of_its_excess_over_the_limit(excess, left):
    """In an image of 1 the limit is 64; `left` is the share of the 63 above the mean.

    Just above the limit it is hardly dimmed; otherwise rounding decides.
    """
    radiance = torch.ones(1, 1, 3, SIDE, SIDE)
    radiance[..., 8, 8] = excess * 64.0
    limited = limit_fireflies(radiance, torch.ones(1, 1, SIDE, SIDE, dtype=torch.int64))
    assert limited[0, 0, 0, 8, 8].item() == pytest.approx(1 + 63 * left, rel=1e-5)


def test_usual_noise_and_two_bright_pixels_side_by_side_stay():
    radiance = noisy()
    radiance[..., 8, 8:10] = 1000.0
    assert limit_fireflies(radiance, COUNTS) is radiance


@pytest.mark.parametrize("value", [math.nan, math.inf, -10.0])
def test_invalid_samples_become_black(value):
    radiance = noisy()
    radiance[:, 1, :, 3, 4] = value
    assert (limit_fireflies(radiance, COUNTS)[:, 1, :, 3, 4] == 0).all()
    mean, others = mean_without_fireflies(radiance, COUNTS), radiance[:, ::2].sum(1) / SPP
    assert torch.allclose(mean[..., 3, 4], others[..., 3, 4])


@pytest.mark.parametrize("exposure", [1e-4, 1e2])
def test_the_limit_follows_the_exposure(exposure):
    """With a lamp of 300 in light of 1, which a fixed cap would cut at one exposure only."""
    radiance = noisy()
    radiance[..., 8, 8] = 300.0
    limited = limit_fireflies(radiance * exposure, COUNTS) / exposure
    assert torch.allclose(limited, limit_fireflies(radiance, COUNTS), rtol=1e-4)


def sparse(share: float, seed: int = 0) -> tuple[Tensor, Tensor]:
    """One sample for a share of 96 x 96 pixels: log-normal noise, and a lamp of 8 x 8 pixels."""
    generator = torch.Generator().manual_seed(seed)
    light = torch.randn(1, 1, 1, 96, 96, generator=generator).exp()
    light[..., 40:48, 40:48] = 300.0
    counts = (torch.rand(1, 1, 96, 96, generator=generator) < share).long()
    return (light * counts.unsqueeze(1)).expand(-1, -1, 3, -1, -1).contiguous(), counts


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1, 0.2, 0.5])
def test_sparse_samples_keep_their_light_and_an_outlier_among_them_is_dimmed(share):
    """Pixels without a sample are no dark neighbours."""
    radiance, counts = sparse(share)
    assert limit_fireflies(radiance, counts).sum() / radiance.sum() > 0.99
    counts[..., 10, 10] = 1
    radiance[..., 10, 10] = 65504.0
    limited = limit_fireflies(radiance, counts)
    if share > 0.01:  # else the window has hardly another sample
        assert limited[0, 0, 0, 10, 10] < 20  # their mean is 1.6
    assert not mean_without_fireflies(radiance, counts).where(counts == 0, 0.0).any()


@pytest.mark.parametrize("share", [0.04, 0.16, 0.7])
def test_neighbours_are_the_largest_of_a_window_that_grows_with_the_holes(share):
    light = torch.rand(1, 1, 24, 30, generator=torch.Generator().manual_seed(1))
    known = torch.zeros(1, 1, 24, 30, dtype=torch.bool)
    known.view(-1)[: round(share * known.numel())] = True
    radius = int(_window_radius(known))
    assert radius == {0.04: 10, 0.16: 5, 0.7: 2}[share]
    windows = F.unfold(F.pad(light, (radius,) * 4, value=NO_PIXEL), 2 * radius + 1)
    windows[:, windows.shape[1] // 2] = NO_PIXEL
    expected = windows.amax(1).view_as(light)
    for each in (radius, torch.tensor(radius).view(1, 1, 1, 1)):
        assert torch.equal(max_of_neighbours(light, each, MAX_RADIUS, NO_PIXEL), expected)


@pytest.mark.parametrize("part", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 65504.0])
def test_broken_light_of_earlier_frames_is_a_neighbours(value, part):
    light = noisy().mean(1), luminance(noisy()).square().mean(1), noisy(1).mean(1)
    broken = [each.clone() for each in light]
    broken[part][..., 8, 8] = value
    for index, (repaired, before) in enumerate(zip(repair_light(*broken), light, strict=True)):
        source = 7 if index == part else 8
        assert torch.equal(repaired[..., 8, 8], before[..., 8, source])
    assert torch.equal(repair_radiance_history(broken[0]), repair_light(*broken)[0])


def test_light_of_earlier_frames_stays_beside_a_lamp_a_thousand_times_brighter():
    samples = noisy()
    samples[:, 0, :, 8, 8] = 1000.0
    mean, second_moment = samples.mean(1), luminance(samples).square().mean(1)
    assert repair_radiance_history(mean) is mean
    assert repair_light(mean, second_moment, mean)[1] is second_moment


def test_bright_history_of_an_image_of_one_pixel_stays():
    bright = torch.full((1, 3, 1, 1), 5e4)
    assert torch.equal(repair_radiance_history(bright), bright)


def test_an_image_in_a_batch_is_limited_as_alone():
    """Also where the images have other shares of pixels with a sample, and so other windows."""
    counts = torch.full((2, 1, SIDE, SIDE), SPP)
    counts[1, :, ::2] = 0
    counts[1, :, :, ::3] = 0
    radiance = torch.cat([noisy(), noisy(1)]) * (counts > 0)[:, None]
    radiance[:, 0, :, 1, 1] = 65504.0
    together = limit_fireflies(radiance, counts)
    alone = [limit_fireflies(radiance[i : i + 1], counts[i : i + 1]) for i in range(2)]
    assert torch.equal(together, torch.cat(alone))


def test_gradients_are_finite_beside_empty_slots_and_windows_without_samples():
    radiance, counts = noisy(), COUNTS.clone()
    counts[..., SIDE // 2 :] = 0  # as wide as no window
    counts[..., 3, 3] = 1
    slots = torch.arange(SPP).view(1, -1, 1, 1)
    radiance = (radiance * (slots < counts)[:, :, None]).requires_grad_()
    outlier = torch.zeros_like(radiance)
    outlier[0, 0, :, 3, 3] = 1e6
    limit_fireflies(radiance + outlier, counts).square().sum().backward()
    gradient = radiance.grad
    assert gradient is not None
    assert gradient.isfinite().all()
    assert (gradient[0, 0, :, 3, 4] != 0).all()


def test_samples_too_far_apart_to_compare_vouch_for_themselves():
    radiance, counts = torch.zeros(1, 1, 3, 1, 99), torch.zeros(1, 1, 1, 99, dtype=torch.int64)
    for x, light in ((0, 1000.0), (98, 2000.0)):
        radiance[..., x], counts[..., x] = light, 1
    assert torch.equal(limit_fireflies(radiance, counts), radiance)


def test_a_light_among_black_pixels_of_a_bright_image_is_no_outlier():
    """Nothing around it vouches for it, but the image's average does: 50 is below 64 times that."""
    radiance = torch.ones(1, 1, 3, 32, 32)
    radiance[..., 5:12, 5:12] = 0.0
    radiance[..., 8, 8] = 50.0
    limited = limit_fireflies(radiance, torch.ones(1, 1, 32, 32, dtype=torch.int64))
    assert torch.equal(limited, radiance)

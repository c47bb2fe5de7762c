"""Blotches: known waves and noise, a twin of scipy, and the noise of the reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import convolve1d

from metrics.blotches import PEAK_GAIN, STRUCTURE, blotches, filter_band, reference_band
from metrics.catalog import BLOTCHES, PSNR
from metrics.metric import Comparison

B3 = np.array([1, 4, 6, 4, 1]) / 16
SIZE = (1, 3, 96, 96)


def gaussian(seed, size=SIZE):
    return torch.randn(size, generator=torch.Generator().manual_seed(seed))


def wall(size=SIZE):
    return torch.full(size, 0.5)


def score(image, a, b):
    """The score of images that the display shows already."""
    return blotches(image, reference_band(a, b), torch.zeros_like(image[:, :1], dtype=torch.bool))


def taps_with_holes(spacing):
    return np.kron(B3, np.eye(1, spacing)[0])[: 4 * spacing + 1]


def smooth_by_scipy(image, spacing):
    for axis in (-2, -1):
        image = convolve1d(image, taps_with_holes(spacing), axis=axis, mode="nearest")
    return image


def band_by_scipy(image):
    fine = smooth_by_scipy(image, 1)
    return (fine - smooth_by_scipy(fine, 2)) / PEAK_GAIN


def gain_at(wavelength):
    """Of a wave along rows: each five taps are the fourth power of a cosine."""
    w = 2 * math.pi / wavelength
    return math.cos(w / 2) ** 4 * (1 - math.cos(w) ** 4) / PEAK_GAIN


def gain_of_white_noise():
    """Root of the sum of the squared taps of the filter in both dimensions."""
    fine = np.convolve(B3, [1])
    coarse = np.convolve(fine, taps_with_holes(2))
    fine = np.pad(fine, 4)
    return float(np.linalg.norm(np.outer(fine, fine) - np.outer(coarse, coarse))) / PEAK_GAIN


@pytest.mark.parametrize("size", [(31, 57), (16, 16), (3, 2), (1, 1)])
def test_the_score_equals_that_of_scipy(size):
    image, a, b = (0.5 + 0.1 * gaussian(seed, (1, 3, *size)) for seed in range(3))
    bands = [band_by_scipy(each[0].double().numpy()) for each in (image, a, b)]
    variance = (bands[1] * bands[2]).mean(0)
    for spacing in (2, 4):
        variance = smooth_by_scipy(variance, spacing)
    weight = (1 + variance.clip(0) / STRUCTURE**2) ** -2
    error = ((bands[0] - bands[1]) * (bands[0] - bands[2])).mean(0)
    expected = 100 * math.sqrt(max((error * weight).sum() / weight.sum(), 0))
    assert score(image, a, b).item() == pytest.approx(expected, rel=1e-3, abs=1e-4)  # float32


@pytest.mark.parametrize("wavelength", [2, 4.81, 7.1177, 11.64, 60])
def test_a_wave_is_passed_by_the_gain_of_its_wavelength(wavelength):
    phase = torch.arange(240) * 2 * math.pi / wavelength
    wave = torch.stack([phase.sin(), phase.cos()]).view(2, 1, 1, 240).expand(2, 1, 8, 240)
    inside = filter_band(wave)[..., 8:-8]
    amplitude = inside.square().sum(0).sqrt()
    torch.testing.assert_close(
        amplitude, torch.full_like(amplitude, gain_at(wavelength)), atol=1e-4, rtol=0
    )


def test_the_gain_is_one_at_seven_pixels_and_has_half_the_power_at_the_ends_of_the_band():
    assert max(map(gain_at, np.linspace(2, 60, 10_000))) == pytest.approx(1, abs=1e-5)
    assert [gain_at(x) ** 2 for x in (4.81, 11.64)] == pytest.approx([0.5, 0.5], abs=0.01)


@pytest.mark.parametrize("sigma", [0.001, 0.05])
def test_white_noise_on_a_wall_scores_its_energy_in_the_band(sigma):
    size = (1, 3, 256, 256)
    expected = 100 * sigma * gain_of_white_noise()
    assert expected == pytest.approx(35.8 * sigma, rel=0.01)
    # 196608 numbers, a tenth of them independent in the band: 0.5 % of the root mean square
    found = score(wall(size) + sigma * gaussian(0, size), wall(size), wall(size)).item()
    assert found == pytest.approx(expected, rel=0.03)


def test_an_offset_and_a_slow_gradient_are_no_blotches():
    ramp = torch.linspace(-0.2, 0.2, 96).expand(SIZE)
    assert score(wall() + 0.1, wall(), wall()).item() == pytest.approx(0, abs=1e-4)
    inside = filter_band(ramp)[..., 8:-8]  # beyond the border the gradient ends
    assert inside.abs().max().item() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("noise", "bias"), [(0.01, 0.0), (0.04, 0.04)])
def test_the_noise_of_the_reference_drops_out_but_for_a_bias_that_is_stated(noise, bias):
    stain = 0.02 * filter_band(gaussian(0))  # 0.7 % of the range, below both noises
    true = score(wall() + stain, wall(), wall()).item()
    draws = [wall() + noise * gaussian(seed) for seed in range(1, 81)]
    pairs = list(zip(draws[::2], draws[1::2], strict=True))
    scores = torch.cat([score(wall() + stain, a, b) for a, b in pairs])
    standard_error = float(scores.std()) / math.sqrt(len(scores))
    assert standard_error < 0.02 * true
    assert -bias * true - 4 * standard_error < float(scores.mean()) - true < 4 * standard_error
    if noise > 0.02:  # one reference of both halves would count its own noise
        plain = torch.cat([score(wall() + stain, (a + b) / 2, (a + b) / 2) for a, b in pairs])
        assert float(plain.mean()) > 1.3 * true


def test_a_faint_stain_on_a_wall_is_worse_than_a_blurred_edge_which_psnr_minds_more():
    edge = wall()
    edge[..., 48:] = 0.9
    blurred = torch.nn.functional.avg_pool2d(edge, (1, 5), 1, (0, 2), count_include_pad=False)
    stained = edge.clone()
    stained[..., 8:32, 8:32] += 0.02 * gaussian(0)[..., 8:32, 8:32]
    assert score(blurred, edge, edge) < score(stained, edge, edge)
    assert PSNR.score(Comparison.of(blurred, edge, edge)) < PSNR.score(
        Comparison.of(stained, edge, edge)
    )


def test_an_image_without_a_finite_pixel_has_the_error_one():
    black = torch.zeros(SIZE)
    assert BLOTCHES.score(Comparison.of(black + math.nan, black, black)).item() == 100


def test_an_error_below_the_noise_of_the_halves_scores_zero():
    a, b = (wall() + 0.05 * gaussian(seed) for seed in range(2))
    assert score((a + b) / 2, a, b).item() == 0

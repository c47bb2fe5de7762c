"""Errors of linear radiance: equal to loops, and sensitive to non-finite pixels."""

from __future__ import annotations

import math

import pytest
import torch
from metric_images import frame_of, image_pair

from metrics.catalog import BIAS, MSE_DEBIASED, RELMSE, RELMSE_TRIMMED, SMAPE
from metrics.image import mse_debiased, nonfinite
from metrics.rel_l2 import REL_L2

NONFINITE = (math.nan, math.inf, -math.inf)


def scored(metric):
    """A metric as a function of image and reference, whose halves are equal."""
    return lambda image, reference: metric.score(frame_of(image, reference))


relmse, relmse_trimmed, smape, bias = map(scored, (RELMSE, RELMSE_TRIMMED, SMAPE, BIAS))
rel_l2 = scored(REL_L2)
FORMULAS = {  # of the three channels of a pixel in image and reference
    relmse: lambda x, r: ((x - r) ** 2 / (r * r + 0.01)).mean(),
    rel_l2: lambda x, r: ((x - r) ** 2).mean() / (r.mean() ** 2 + 0.01),
    smape: lambda x, r: (abs(x - r) / (abs(x) + abs(r) + 0.01)).mean(),
}


@pytest.mark.parametrize("size", [(5, 9), (1, 1)])
@pytest.mark.parametrize("metric", FORMULAS)
def test_an_error_equals_a_loop_over_pixels(metric, size):
    image, reference = image_pair(*size)
    expected = []
    for x, r in zip(image.double(), reference.double(), strict=True):
        pixels = zip(x.flatten(1).T, r.flatten(1).T, strict=True)
        terms = [float(FORMULAS[metric](*pixel)) for pixel in pixels]
        expected.append(sum(terms) / len(terms))
    assert metric(image, reference).tolist() == pytest.approx(expected, rel=1e-6)  # float32 result


@pytest.mark.parametrize("exposure", [1.0, 0.01])
def test_trimmed_relmse_equals_a_loop_over_sorted_pixels(exposure):
    image, reference = image_pair(40, 60)
    expected = []
    for x, r in zip(image.double(), reference.double(), strict=True):
        x, r = x / r.mean(), r / r.mean()
        errors = sorted(((x - r) ** 2 / (r * r + 0.01)).mean(0).flatten().tolist())
        expected.append(sum(errors[:-2]) / (2400 - 2))  # 0.1 % of 2400 pixels
    scores = relmse_trimmed(exposure * image, exposure * reference)
    assert scores.tolist() == pytest.approx(expected, rel=1e-5)  # float32 images


def test_trimmed_relmse_leaves_out_fireflies_but_no_pixel_that_is_not_finite():
    image, reference = image_pair(40, 60, n=1)
    clean = float(relmse_trimmed(image, reference))
    image[0, :, 3, 3] = 6e4
    assert float(relmse_trimmed(image, reference)) == pytest.approx(clean, rel=0.1)
    image[0, :, 3, 3] = math.nan
    assert float(relmse_trimmed(image, reference)) > 1e4 * clean


@pytest.mark.parametrize("value", [*NONFINITE, 1e38, -1e38])
@pytest.mark.parametrize("metric", [relmse, rel_l2, scored(MSE_DEBIASED)])
def test_linear_errors_of_extreme_pixels_are_finite_and_large(metric, value):
    image, reference = image_pair(16, 16, n=1)
    damaged = image.clone()
    damaged[0, 0, 3, 3] = value
    assert math.isfinite(float(metric(damaged, reference)))
    assert float(metric(damaged, reference)) > 1e5 * float(metric(image, reference))


@pytest.mark.parametrize("value", NONFINITE)
def test_a_nonfinite_pixel_has_symmetric_error_one_and_is_counted_once(value):
    reference = torch.full((2, 3, 10, 10), 0.3)
    image = reference.clone()
    image[0, 1:, 4, 4] = value
    assert smape(image, reference).tolist() == pytest.approx([0.01, 0])
    assert nonfinite(image).tolist() == [1, 0]


def test_the_mean_of_the_debiased_error_is_the_true_error():
    g = torch.Generator().manual_seed(1)
    truth = torch.full((400, 3, 8, 8), 0.5)  # 400 independent trials in one batch
    a, b = (truth + 0.5 * torch.randn(truth.shape, generator=g) for _ in range(2))
    scores = mse_debiased(truth + 0.1, a, b).double()
    standard_error = float(scores.std()) / math.sqrt(len(scores))
    assert abs(float(scores.mean()) - 0.01) < 4 * standard_error


def test_the_debiased_error_of_equal_halves_is_the_plain_error():
    image, reference = image_pair(9, 7)
    plain = (image - reference).square().flatten(1).mean(1)
    torch.testing.assert_close(mse_debiased(image, reference, reference), plain)


@pytest.mark.parametrize("gain", [0.75, 1.0, 1.5])
def test_bias_is_the_excess_radiance_in_percent(gain):
    _, reference = image_pair(9, 7)
    expected = torch.full((2,), 100 * (gain - 1))
    torch.testing.assert_close(bias(reference * gain, reference), expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("metric", [relmse, bias, scored(MSE_DEBIASED)])
def test_radiance_beyond_half_floats_in_image_and_reference_is_no_error(metric):
    _, reference = image_pair(16, 16, n=1)
    reference[0, :, 3, 3] = 1e6
    assert float(metric(reference, reference)) == 0

"""PSNR: equal to other libraries, and without the noise of the reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from metric_images import frame_of, image_pair
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio
from torchmetrics.functional.image import peak_signal_noise_ratio as torchmetrics_psnr

from metrics.catalog import MSE, PSNR, PSNR_DEBIASED
from metrics.display import encode_display
from metrics.metric import Comparison
from metrics.psnr import CAP_DB

SIZE = (1, 3, 96, 96)
SHAPE = 0.5  # of the gamma distribution of one sample, whose relative variance is 2
TRUTH_SPP, HALF_SPP = 16384, 64


def score(metric, image, reference):
    return metric.score(frame_of(image, reference))


@pytest.mark.parametrize("size", [(32, 48), (31, 57), (1, 1)])
def test_psnr_and_mse_equal_scikit_image(size):
    image, reference = image_pair(*size)
    encoded = [encode_display(each).double().numpy() for each in (reference, image)]
    pairs = list(zip(*encoded, strict=True))
    expected = [peak_signal_noise_ratio(*pair, data_range=1.0) for pair in pairs]
    # float32 display values against float64, about 1e-6 of the error
    assert score(PSNR, image, reference).tolist() == pytest.approx(expected, abs=1e-4)
    expected = [mean_squared_error(*pair) for pair in pairs]
    assert score(MSE, image, reference).tolist() == pytest.approx(expected, rel=1e-5)


def test_psnr_equals_torchmetrics():
    image, reference = image_pair(40, 50)
    expected = torchmetrics_psnr(
        encode_display(image), encode_display(reference), data_range=1.0, reduction="none",
        dim=(1, 2, 3),
    )  # fmt: skip
    torch.testing.assert_close(score(PSNR, image, reference), expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize(("value", "expected"), [(0.0, 0.0), (1.0, CAP_DB), (1e30, CAP_DB)])
def test_psnr_against_display_white(value, expected):
    white = torch.ones(1, 3, 8, 8)
    assert score(PSNR, value * white, white).tolist() == pytest.approx([expected], abs=1e-5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("metric", [PSNR, PSNR_DEBIASED], ids=lambda m: m.name)
def test_a_nonfinite_pixel_has_display_error_one(metric, value):
    reference = torch.full((1, 3, 10, 10), 0.3)
    image = reference.clone()
    image[0, 1, 4, 4] = value  # one channel invalidates the pixel: MSE 1/100
    assert score(metric, image, reference).tolist() == pytest.approx([20.0], abs=1e-4)


def monte_carlo_scene(seed=0):
    """Radiance [1 3 h w] of a scene, and `render(spp)`: the mean of gamma-distributed samples.

    The mean of n gamma variates of shape k is one gamma variate of shape n k.
    """
    random = np.random.default_rng(seed)
    radiance = np.exp(random.normal(-1.5, 1, SIZE))

    def render(spp):
        shape = SHAPE * spp
        return torch.from_numpy(radiance * random.gamma(shape, 1 / shape, SIZE)).float()

    return render


def scores_of_two_images(seed=0):
    """True PSNR, PSNR and debiased PSNR of a better and a worse image of one scene."""
    render = monte_carlo_scene(seed)
    truth, a, b = render(TRUTH_SPP), render(HALF_SPP), render(HALF_SPP)
    g = torch.Generator().manual_seed(seed)
    scores = []
    for error in (0.1, 0.2):
        image = truth * (error * torch.randn(SIZE, generator=g)).exp()
        frame = Comparison.of(image, a, b)
        scores.append(
            [
                float(score(PSNR, image, truth)),
                *(float(m.score(frame)) for m in (PSNR, PSNR_DEBIASED)),
            ]
        )
    return scores


def test_halves_of_64_spp_give_the_psnr_and_the_lead_of_a_truth_of_16384_spp():
    (true, plain, debiased), (true_worse, plain_worse, debiased_worse) = scores_of_two_images()
    assert plain < true - 3  # the noise of 64 + 64 spp caps PSNR at about 30 dB
    assert plain - plain_worse < 0.6 * (true - true_worse)
    # what remains is the bend of the display curve: a mean of 0.003 of display white
    assert debiased == pytest.approx(true, abs=0.4)
    assert debiased - debiased_worse == pytest.approx(true - true_worse, abs=0.4)


def test_the_bias_of_an_encoded_half_is_its_variance_times_the_bend_of_the_curve():
    render = monte_carlo_scene()
    truth = render(TRUTH_SPP).double()
    bias = torch.stack([encode_display(render(HALF_SPP)) for _ in range(20)]).double().mean(0)
    bias -= encode_display(truth)
    curved = (truth > 0.01) & (truth < 0.5)  # the power of 1 / 2.4, and no clipping
    bend = 1.055 / 2.4 * (1 / 2.4 - 1) * truth ** (1 / 2.4 - 2)
    variance = truth**2 / (SHAPE * HALF_SPP)
    expected = float((bend * variance / 2)[curved].mean())
    assert expected < 0
    assert float(bias[curved].mean()) == pytest.approx(expected, rel=0.1)  # of 20 draws, 2nd order


def test_an_error_below_the_noise_of_the_halves_scores_the_cap():
    render = monte_carlo_scene()
    a, b = render(HALF_SPP), render(HALF_SPP)
    assert PSNR_DEBIASED.score(Comparison.of((a + b) / 2, a, b)).tolist() == [CAP_DB]

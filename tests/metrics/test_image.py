"""Image metrics: equal to other libraries and to loops, and sensitive to non-finite pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from metrics.display import encode_display
from metrics.image import (
    CAP_DB,
    SCALE_WEIGHTS,
    bias,
    max_scales,
    ms_ssim,
    mse_debiased,
    nonfinite,
    psnr,
    relmse,
)

NONFINITE = (math.nan, math.inf, -math.inf)


def image_pair(h, w, noise=0.3, seed=0, n=2):
    """Image and reference [n 3 h w]: blocks, some above white, and noise on the image."""
    g = torch.Generator().manual_seed(seed)
    blocks = torch.rand(n, 3, h // 7 + 1, w // 7 + 1, generator=g) ** 3 * 2
    reference = blocks.repeat_interleave(7, 2).repeat_interleave(7, 3)[..., :h, :w]
    return reference * (1 + noise * torch.randn(n, 3, h, w, generator=g)), reference


def srgb_array(image):
    return encode_display(image).permute(0, 2, 3, 1).double().numpy()


def skimage_ms_ssim(x, y, scales):
    """MS-SSIM of one channel by scikit-image, scale by scale; x, y [h w] in [0, 1]."""
    total = sum(SCALE_WEIGHTS) / sum(SCALE_WEIGHTS[:scales])
    score = 1.0
    for scale in range(scales):
        k1 = 0.01 if scale == scales - 1 else 1e6  # a huge K1 leaves contrast only
        term = structural_similarity(
            x, y, data_range=1.0, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False, K1=k1, K2=0.03,
        )  # fmt: skip
        score *= max(term, 0.0) ** (SCALE_WEIGHTS[scale] * total)
        x, y = halve(x), halve(y)
    return score


def halve(x):
    """Mean over 2 x 2 pixels; an odd side is first padded with a row of zeros at both ends."""
    x = np.pad(x, [(side % 2, side % 2) for side in x.shape])
    rows, columns = (side // 2 * 2 for side in x.shape)
    x = x[:rows, :columns]
    return (x[::2, ::2] + x[1::2, ::2] + x[::2, 1::2] + x[1::2, 1::2]) / 4


@pytest.mark.parametrize("size", [(32, 48), (31, 57), (1, 1)])
def test_psnr_equals_scikit_image(size):
    image, reference = image_pair(*size)
    expected = [
        peak_signal_noise_ratio(y, x, data_range=1.0)
        for x, y in zip(srgb_array(image), srgb_array(reference), strict=True)
    ]
    # float32 display values against float64, about 1e-6 of the error
    assert psnr(image, reference).tolist() == pytest.approx(expected, abs=1e-4)


def test_psnr_of_equal_images_is_the_cap():
    image, _ = image_pair(16, 16)
    assert psnr(image, image).tolist() == [CAP_DB, CAP_DB]


def test_psnr_of_black_against_white_is_zero():
    black = torch.zeros(1, 3, 8, 8)
    assert psnr(black, black + 1).tolist() == pytest.approx([0.0], abs=1e-5)  # float32 white


def test_psnr_ignores_radiance_above_display_white():
    reference = torch.full((1, 3, 8, 8), 1.0)
    assert psnr(reference * 1e30, reference).tolist() == [CAP_DB]


@pytest.mark.parametrize("value", NONFINITE)
def test_a_nonfinite_pixel_has_display_error_one(value):
    reference = torch.full((1, 3, 10, 10), 0.3)
    image = reference.clone()
    image[0, 1, 4, 4] = value  # one channel invalidates the pixel: MSE 1/100
    assert psnr(image, reference).tolist() == pytest.approx([20.0], abs=1e-4)


@pytest.mark.parametrize("size", [(176, 176), (163, 181)])
def test_ms_ssim_equals_scikit_image_over_five_scales(size):
    image, reference = image_pair(*size, n=1)
    x, y = srgb_array(image)[0], srgb_array(reference)[0]
    expected = np.mean([skimage_ms_ssim(x[..., c], y[..., c], 5) for c in range(3)])
    # variances are differences of float32 squares: 1e-7 over C2 = 9e-4
    assert float(ms_ssim(image, reference)) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize(
    ("size", "scales"), [((96, 128), 4), ((57, 70), 3), ((21, 40), 2), ((11, 11), 1)]
)
def test_ms_ssim_of_a_small_image_equals_scikit_image(size, scales):
    image, reference = image_pair(*size, n=1)
    x, y = srgb_array(image)[0], srgb_array(reference)[0]
    expected = np.mean([skimage_ms_ssim(x[..., c], y[..., c], scales) for c in range(3)])
    assert float(ms_ssim(image, reference, scales)) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize(
    ("side", "scales"),
    [(10, 0), (11, 1), (20, 1), (21, 2), (40, 2), (80, 3), (81, 4), (160, 4), (161, 5), (2160, 5)],
)
def test_max_scales_keeps_a_whole_window_at_the_coarsest_scale(side, scales):
    assert max_scales(side, 5000) == scales


def test_ms_ssim_with_too_many_scales_names_the_alternative():
    image, reference = image_pair(160, 200)
    with pytest.raises(ValueError, match=r"sides above 160 pixels, found 160 x 200, which allow 4"):
        ms_ssim(image, reference)


@pytest.mark.parametrize("scales", [5, 4])
def test_ms_ssim_of_an_inverted_image_is_finite(scales):
    image, reference = image_pair(170, 170, n=1)
    assert 0 <= float(ms_ssim(1 - reference, reference, scales)) < 0.5


@pytest.mark.parametrize("value", NONFINITE)
def test_a_nonfinite_pixel_lowers_ms_ssim(value):
    image, reference = image_pair(176, 176, noise=0.05, n=1)
    damaged = image.clone()
    damaged[0, :, 80, 80] = value
    assert 0 < float(ms_ssim(damaged, reference)) < float(ms_ssim(image, reference))


@pytest.mark.parametrize("size", [(5, 9), (1, 1)])
def test_relmse_equals_a_loop(size):
    image, reference = image_pair(*size)
    expected = []
    for x, r in zip(image.double(), reference.double(), strict=True):
        terms = [
            (p - q) ** 2 / (q * q + 0.01) for p, q in zip(x.flatten(), r.flatten(), strict=True)
        ]
        expected.append(float(sum(terms) / len(terms)))
    assert relmse(image, reference).tolist() == pytest.approx(expected, rel=1e-6)  # float32 result


def test_relmse_of_black_against_black_is_zero():
    black = torch.zeros(1, 3, 8, 8)
    assert relmse(black, black).tolist() == [0.0]


@pytest.mark.parametrize("value", [*NONFINITE, 1e38, -1e38])
@pytest.mark.parametrize("metric", ["relmse", "mse_debiased"])
def test_linear_errors_of_extreme_pixels_are_finite_and_large(metric, value):
    image, reference = image_pair(16, 16, n=1)
    damaged = image.clone()
    damaged[0, 0, 3, 3] = value
    score = {"relmse": relmse, "mse_debiased": lambda x, r: mse_debiased(x, r, r)}[metric]
    assert math.isfinite(float(score(damaged, reference)))
    assert float(score(damaged, reference)) > 1e5 * float(score(image, reference))


@pytest.mark.parametrize("value", NONFINITE)
def test_a_nonfinite_pixel_is_at_least_as_bad_as_any_finite_one(value):
    image, reference = image_pair(16, 16, n=1)
    damaged, huge = image.clone(), image.clone()
    damaged[0, :, 3, 3], huge[0, :, 3, 3] = value, 3e38
    assert float(relmse(damaged, reference)) >= float(relmse(huge, reference))


def noisy_halves(seed, noise=0.5):
    g = torch.Generator().manual_seed(seed)
    truth = torch.full((400, 3, 8, 8), 0.5)  # 400 independent trials in one batch
    a, b = (truth + noise * torch.randn(truth.shape, generator=g) for _ in range(2))
    return truth + 0.1, a, b  # squared error 0.01


def test_the_mean_of_the_debiased_error_is_the_true_error():
    scores = mse_debiased(*noisy_halves(1)).double()
    standard_error = float(scores.std()) / math.sqrt(len(scores))
    assert abs(float(scores.mean()) - 0.01) < 4 * standard_error


def test_the_plain_error_includes_the_noise_of_the_reference():
    image, a, b = noisy_halves(1)
    scores = (image - (a + b) / 2).square().flatten(1).mean(1).double()
    standard_error = float(scores.std()) / math.sqrt(len(scores))
    assert float(scores.mean()) - 0.01 > 40 * standard_error  # by noise^2 / 2 = 0.125


def test_the_debiased_error_of_equal_halves_is_the_plain_error():
    image, reference = image_pair(9, 7)
    plain = (image - reference).square().flatten(1).mean(1)
    torch.testing.assert_close(mse_debiased(image, reference, reference), plain)


@pytest.mark.parametrize("gain", [0.75, 1.0, 1.5])
def test_bias_is_the_excess_radiance_in_percent(gain):
    _, reference = image_pair(9, 7)
    expected = torch.full((2,), 100 * (gain - 1))
    torch.testing.assert_close(bias(reference * gain, reference), expected, atol=1e-4, rtol=0)


def test_bias_of_zero_mean_noise_is_within_its_standard_error():
    image, reference = image_pair(70, 70, noise=0.3)
    error = 30 * reference.square().sum((1, 2, 3)).sqrt() / reference.sum((1, 2, 3))
    assert (bias(image, reference).abs() < 4 * error).all()


@pytest.mark.parametrize("metric", [relmse, bias, lambda x, r: mse_debiased(x, r, r)])
def test_radiance_beyond_half_floats_in_image_and_reference_is_no_error(metric):
    _, reference = image_pair(16, 16, n=1)
    reference[0, :, 3, 3] = 1e6
    assert float(metric(reference, reference)) == 0


@pytest.mark.parametrize("value", NONFINITE)
def test_a_nonfinite_pixel_counts_as_bias(value):
    image, reference = image_pair(16, 16, n=1)
    image[0, 0, 3, 3] = value
    assert float(bias(image, reference)) < -1000


def test_nonfinite_counts_pixels_not_channels():
    image = torch.zeros(2, 3, 5, 5)
    image[0, :, 1, 1] = math.nan
    image[0, 2, 3, 3] = -math.inf
    assert nonfinite(image).tolist() == [2.0, 0.0]

"""SSIM and MS-SSIM: equal to pytorch-msssim, torchmetrics and scikit-image."""

from __future__ import annotations

import numpy as np
import pytest
import pytorch_msssim
import torch
from metric_images import encoded_pair, frame_of, image_pair, skimage_ssim
from torchmetrics.functional.image import structural_similarity_index_measure

from metrics.catalog import MS_SSIM
from metrics.ssim import BLOCK, SCALE_WEIGHTS, max_scales, ms_ssim, ssim

EDGES = [(11, 11), (11, 42), (42, 43), (BLOCK + 10, 2 * BLOCK + 10), (53, 75), (100, 90)]


@pytest.mark.parametrize("size", EDGES)
def test_ssim_equals_pytorch_msssim_at_every_edge_of_a_tile(size):
    pair = encoded_pair(*size)
    expected = pytorch_msssim.ssim(*pair, data_range=1.0, size_average=False)
    # both are float32; a variance, a difference of squares near 1, has rounding of 1e-7
    torch.testing.assert_close(ssim(*pair), expected, atol=2e-5, rtol=0)


@pytest.mark.parametrize("size", [(176, 176), (163, 181), (321, 200)])
def test_ms_ssim_equals_pytorch_msssim(size):
    pair = encoded_pair(*size)
    expected = pytorch_msssim.ms_ssim(*pair, data_range=1.0, size_average=False)
    torch.testing.assert_close(ms_ssim(*pair), expected, atol=5e-5, rtol=0)  # as above, five times


def test_ssim_equals_torchmetrics_inside_the_image():
    image, reference = (each.double() for each in encoded_pair(60, 70))
    _, by_pixel = structural_similarity_index_measure(
        image, reference, data_range=1.0, return_full_image=True, reduction="none"
    )
    inside = by_pixel[..., 5:-5, 5:-5].mean((1, 2, 3))  # its windows reach over the edge
    torch.testing.assert_close(ssim(image, reference).double(), inside, atol=1e-6, rtol=0)


@pytest.mark.parametrize("size", [(31, 57), (11, 11)])
def test_ssim_equals_scikit_image(size):
    pair = encoded_pair(*size, n=1)
    x, y = (each[0].double().numpy() for each in pair)
    expected = skimage_ssim(x, y, channel_axis=0)
    assert float(ssim(*pair)) == pytest.approx(expected, abs=2e-5)


def skimage_ms_ssim(x, y, scales):
    """MS-SSIM of one channel by scikit-image, scale by scale; x, y [h w] in [0, 1]."""
    total = sum(SCALE_WEIGHTS) / sum(SCALE_WEIGHTS[:scales])
    score = 1.0
    for scale in range(scales):
        k1 = 0.01 if scale == scales - 1 else 1e6  # a huge K1 leaves contrast only
        term = skimage_ssim(x, y, K1=k1, K2=0.03)
        score *= max(term, 0.0) ** (SCALE_WEIGHTS[scale] * total)
        x, y = halve(x), halve(y)
    return score


def halve(x):
    """Mean over 2 x 2 pixels; an odd side is first padded with a row of zeros at both ends."""
    x = np.pad(x, [(side % 2, side % 2) for side in x.shape])
    rows, columns = (side // 2 * 2 for side in x.shape)
    x = x[:rows, :columns]
    return (x[::2, ::2] + x[1::2, ::2] + x[::2, 1::2] + x[1::2, 1::2]) / 4


@pytest.mark.parametrize(
    ("size", "scales"),
    [((176, 176), 5), ((163, 181), 5), ((96, 128), 4), ((57, 70), 3), ((21, 40), 2), ((11, 11), 1)],
)
def test_ms_ssim_equals_scikit_image(size, scales):
    image, reference = encoded_pair(*size, n=1)
    x, y = image[0].double().numpy(), reference[0].double().numpy()
    expected = np.mean([skimage_ms_ssim(x[c], y[c], scales) for c in range(3)])
    # variances are differences of float32 squares: 1e-7 over C2 = 9e-4
    assert float(ms_ssim(image, reference, scales)) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize(
    ("side", "scales"),
    [(10, 0), (11, 1), (20, 1), (21, 2), (40, 2), (80, 3), (81, 4), (160, 4), (161, 5), (2160, 5)],
)
def test_max_scales_keeps_a_whole_window_at_the_coarsest_scale(side, scales):
    assert max_scales(side, 5000) == scales


def test_ms_ssim_with_too_many_scales_names_the_alternative():
    frame = frame_of(*image_pair(160, 200))
    words = r"sides above 160 pixels, found 160 x 200, which allow 4. Use MS_SSIM.at"
    with pytest.raises(ValueError, match=words):
        MS_SSIM.score(frame)


@pytest.mark.parametrize("levels", [(0.5, 0.5001), (0.9, 0.9002), (1.0, 1.0), (0.0, 1e-4)])
def test_two_flat_images_are_no_more_than_equal(levels):
    image, reference = (torch.full((1, 3, 180, 200), level) for level in levels)
    for score in (ssim, ms_ssim):
        # by the luminance term alone, which float32 has to 1e-5 here
        expected = (2 * levels[0] * levels[1] + 1e-4) / (levels[0] ** 2 + levels[1] ** 2 + 1e-4)
        expected **= 1 if score is ssim else SCALE_WEIGHTS[-1]
        assert expected - 5e-5 <= float(score(image, reference)) <= 1


@pytest.mark.parametrize("scales", [5, 4])
def test_ms_ssim_of_an_inverted_image_is_finite(scales):
    _, reference = encoded_pair(170, 170, n=1)
    assert 0 <= float(ms_ssim(1 - reference, reference, scales)) < 0.5

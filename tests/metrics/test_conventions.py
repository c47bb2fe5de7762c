"""Conventions: each encodes as its source does, and a metric takes its name along."""

from __future__ import annotations

import math
import pickle

import kornia
import numpy as np
import pytest
import torch
from metric_images import encoded_pair, frame_of, image_pair, skimage_ssim
from skimage.metrics import peak_signal_noise_ratio

from metrics.catalog import MS_SSIM, MSE, PSNR, RELMSE, SSIM
from metrics.conventions import CONVENTIONS, SRGB, get_convention
from metrics.display import encode_aces, encode_display, encode_hable

NAMES = tuple(CONVENTIONS)


def test_values_within_the_range_equal_the_srgb_of_kornia():
    linear = torch.rand(2, 3, 17, 13, generator=torch.Generator().manual_seed(0)) ** 4
    expected = kornia.color.linear_rgb_to_rgb(linear)
    # float32 powers from two libraries
    torch.testing.assert_close(encode_display(linear), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("linear", "srgb"), [(-1.0, 0.0), (0.001, 0.01292), (1e30, 1.0), (math.nan, math.nan)]
)
def test_srgb_is_clipped_and_nan_stays_nan(linear, srgb):
    assert float(encode_display(torch.tensor(linear))) == pytest.approx(srgb, nan_ok=True)


@pytest.mark.parametrize("name", NAMES)
def test_every_convention_brightens_with_radiance_within_the_display(name):
    ramp = torch.cat([torch.tensor([-1.0, 0.0]), torch.logspace(-4, 2, 200)])
    ramp = torch.cat([ramp, torch.tensor([3e38, math.inf])]).expand(1, 3, 1, 204)
    encoded = CONVENTIONS[name].encode(ramp)[0, 0, 0]
    assert ((encoded >= 0) & (encoded <= 1)).all()
    assert (encoded[2:-2].diff() >= -1e-6).all()  # float32
    assert encoded[2] < 0.05
    assert encoded[-3] > 0.9


def test_8_bits_round_the_sending_values_of_the_paper_and_cut_those_of_noisebase():
    radiance = 1.2 * torch.rand(1, 3, 20, 20, generator=torch.Generator().manual_seed(0))
    rounded = np.rint(encode_display(radiance).numpy() * 255)
    cut = (encode_aces(radiance).numpy() * 255).astype(np.uint8)
    for name, expected in (("paper2023", rounded), ("noisebase-v1", cut)):
        np.testing.assert_allclose(
            CONVENTIONS[name].encode(radiance).numpy() * 255, expected, atol=1e-4
        )


def test_aces_equals_a_loop_over_pixels():
    def rational(v):
        return (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)

    first = np.array(
        [[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]]
    )
    last = np.array(
        [
            [1.60475, -0.53108, -0.07367],
            [-0.10208, 1.10813, -0.00605],
            [-0.00327, -0.07276, 1.07602],
        ]
    )
    colours = torch.rand(7, 3, generator=torch.Generator().manual_seed(1)) * 3
    expected = [
        np.clip(last @ rational(first @ c), 0, 1) ** (1 / 2.2) for c in colours.double().numpy()
    ]
    found = encode_aces(colours.mT.view(1, 3, 1, 7))[0, :, 0].mT
    np.testing.assert_allclose(found, expected, atol=2e-6)  # float32


def test_hables_curve_has_its_known_points():
    # closed forms: 0 stays 0, and the white point over the exposure bias is white
    values = encode_hable(torch.tensor([0.0, 11.2 / 1.758141, 1e4]))
    assert values.tolist() == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)


def test_the_papers_peak_is_the_range_of_the_reference():
    image, reference = image_pair(30, 40, n=1)
    image, reference = 0.2 * image, 0.2 * reference
    x, y = (
        CONVENTIONS["paper2023"].encode(each)[0].double().numpy() for each in (image, reference)
    )
    expected = peak_signal_noise_ratio(y, x, data_range=y.max() - min(y.min(), 0))
    found = PSNR.under("paper2023").score(frame_of(image, reference))
    assert float(found) == pytest.approx(expected, abs=1e-4)
    assert float(found) < float(PSNR.score(frame_of(image, reference))) - 1  # 20 log10 of the peak


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("metric", [PSNR, MSE, SSIM, MS_SSIM], ids=lambda m: m.name)
def test_a_metric_under_a_convention_says_so_and_is_finite(metric, name):
    image, reference = image_pair(165, 170)
    image[0, 0, 5, 5] = math.nan
    under = metric.under(name)
    assert under.name == f"{metric.name}@{name}"
    assert under.convention.startswith(CONVENTIONS[name].sentence)
    assert not under.scored_by_run
    assert pickle.loads(pickle.dumps(under)).name == under.name  # for workers
    score = under.at(165, 170).score(frame_of(image, reference))
    assert score.isfinite().all()
    if name == "srgb":
        torch.testing.assert_close(score, metric.score(frame_of(image, reference)))


@pytest.mark.parametrize("name", NAMES)
def test_ssim_under_a_convention_equals_scikit_image(name):
    x, y = encoded_pair(40, 50, n=1, convention=CONVENTIONS[name])
    expected = skimage_ssim(x[0].double().numpy(), y[0].double().numpy(), channel_axis=0)
    found = SSIM.under(name).score(frame_of(*image_pair(40, 50, n=1)))
    assert float(found) == pytest.approx(expected, abs=2e-5)  # float32 variances


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: get_convention("aces"), "'aces' is no convention; there are: srgb, paper2023, "),
        (lambda: RELMSE.under("hable"), "'relmse' has one convention"),  # of linear radiance
    ],
)
def test_a_convention_that_does_not_exist_is_an_error(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_a_convention_is_encoded_once_for_all_metrics_of_a_frame():
    frame = frame_of(*image_pair(20, 20))
    assert frame.encode(CONVENTIONS["hable"]) is frame.encode(CONVENTIONS["hable"])
    assert frame.encode() is frame.encode(SRGB)

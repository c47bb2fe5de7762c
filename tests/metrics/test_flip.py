"""FLIP against a slow twin written from the papers, and a child process that ends or hangs."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
import torch

from metrics.flip import (
    FLIP,
    HDR_FLIP,
    PIXELS_PER_DEGREE,
    FlipError,
    FlipProcess,
    FlipRefusedError,
)

pytest.importorskip("flip_evaluator")

TO_XYZ = np.array(  # linear sRGB, D65: IEC 61966-2-1
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
WHITE = TO_XYZ.sum(1)
CSF = {  # contrast sensitivity by opponent channel, a1, b1, a2, b2: Andersson et al. 2020, table 1
    "achromatic": (1.0, 0.0047, 0.0, 1e-5),
    "red-green": (1.0, 0.0053, 0.0, 1e-5),
    "blue-yellow": (34.1, 0.04, 13.5, 0.025),
}
ACES = (0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14)  # Narkowicz 2015
TOLERANCE = 2e-3  # of errors near 0.2: the package sums in float32, its matrices have more digits


def filtered(plane, kernel):
    """A plane after a kernel of odd sides; borders are repeated."""
    h, w = (side // 2 for side in kernel.shape)
    padded = np.pad(plane, ((h, h), (w, w)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape)
    return np.einsum("ijkl,kl->ij", windows, kernel[::-1, ::-1])


def grid(radius):
    return np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(float)


def spatial_kernel(name):
    a1, b1, a2, b2 = CSF[name]
    radius = math.ceil(3 * math.sqrt(0.04 / (2 * math.pi**2)) * PIXELS_PER_DEGREE)
    squared = (grid(radius) ** 2).sum(0) / PIXELS_PER_DEGREE**2
    kernel = sum(
        a * math.sqrt(math.pi / b) * np.exp(-(math.pi**2) * squared / b)
        for a, b in ((a1, b1), (a2, b2))
    )
    return kernel / kernel.sum()


def opponent(linear):
    x, y, z = np.moveaxis(linear @ TO_XYZ.T / WHITE, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def perceived(linear):
    """Hunt-adjusted L*a*b* after the contrast sensitivity of the eye, [3 h w]."""
    y, cx, cz = (
        filtered(plane, spatial_kernel(name))
        for plane, name in zip(opponent(linear), CSF, strict=True)
    )
    y = (y + 16) / 116
    xyz = np.stack([y + cx / 500, y, y - cz / 200], -1) * WHITE
    return hunt_lab((xyz @ np.linalg.inv(TO_XYZ).T).clip(0, 1))


def hunt_lab(linear):
    ratios = linear @ TO_XYZ.T / WHITE
    delta = 6 / 29
    x, y, z = np.moveaxis(
        np.where(ratios > delta**3, np.cbrt(ratios), ratios / (3 * delta**2) + 4 / 29), -1, 0
    )
    lightness = 116 * y - 16
    return np.stack([lightness, lightness * 5 * (x - y), lightness * 2 * (y - z)])


def hyab(lab, other):
    difference = lab - other
    return np.abs(difference[0]) + np.hypot(difference[1], difference[2])


def colour_error(reference, image):
    green, blue = (hunt_lab(np.array([[c]], float)) for c in ((0, 1, 0), (0, 0, 1)))
    largest = hyab(green, blue).item() ** 0.7
    error = hyab(perceived(reference), perceived(image)) ** 0.7
    knee = 0.4 * largest
    high = 0.95 + (error - knee) / (largest - knee) * 0.05
    return np.where(error < knee, error * 0.95 / knee, high)


def feature_strength(linear, kind):
    deviation = 0.5 * 0.082 * PIXELS_PER_DEGREE
    y, x = grid(math.ceil(3 * deviation))
    gauss = np.exp(-(x**2 + y**2) / (2 * deviation**2))
    kernel = -x * gauss if kind == "edge" else (x**2 / deviation**2 - 1) * gauss
    kernel = np.where(
        kernel > 0, kernel / kernel[kernel > 0].sum(), -kernel / kernel[kernel < 0].sum()
    )
    luminance = (opponent(linear)[0] + 16) / 116
    return np.hypot(filtered(luminance, kernel), filtered(luminance, kernel.T))


def flip_map(reference, image):
    """FLIP error of linear images in [0, 1], [h w 3]."""
    feature = np.maximum(
        *(
            np.abs(feature_strength(reference, kind) - feature_strength(image, kind))
            for kind in ("edge", "point")
        )
    )
    return colour_error(reference, image) ** (1 - (feature / math.sqrt(2)) ** 0.5)


def tone_mapped(linear):
    k = ACES
    shown = (k[0] * linear**2 + k[1] * linear + k[2]) / (k[3] * linear**2 + k[4] * linear + k[5])
    return shown.clip(0, 1)


def hdr_flip_map(reference, image):
    k, target = ACES, 0.85  # of the tone curve: Andersson et al. 2021, section 3
    brightest = np.roots([k[0] - target * k[3], k[1] - target * k[4], k[2] - target * k[5]]).max()
    luminance = reference @ TO_XYZ[1]
    first, last = np.log2(brightest / luminance.max()), np.log2(brightest / np.median(luminance))
    exposures = np.linspace(first, last, max(2, math.ceil(last - first)))
    return np.max(
        [
            flip_map(tone_mapped(reference * 2**exposure), tone_mapped(image * 2**exposure))
            for exposure in exposures
        ],
        axis=0,
    )


def decode(srgb):
    return np.where(srgb > 0.04045, ((srgb + 0.055) / 1.055) ** 2.4, srgb / 12.92)


@pytest.fixture(scope="module")
def images():
    """Linear images of 37 x 41 pixels with a step, a dot and a slope; of noise in one of them."""
    rng = np.random.default_rng(0)
    reference = np.linspace(0.02, 0.7, 37 * 41 * 3).reshape(37, 41, 3)
    reference[:, 20:] *= 0.3
    reference[10, 8] = 3.0
    image = reference * rng.gamma(8, 1 / 8, reference.shape)
    return reference, image


def tensors(*arrays):
    return [torch.from_numpy(array).movedim(-1, 0)[None].float() for array in arrays]


def test_flip_is_that_of_a_twin_from_the_paper(images):
    reference, image = tensors(*images)
    comparison = FLIP.compare(image, reference, reference)
    shown = [
        decode(x[0].movedim(0, -1).double().numpy())
        for x in (comparison.display_reference, comparison.display_image)
    ]
    expected = flip_map(*shown).mean()
    assert 0.1 < expected < 0.5
    assert FLIP.score(comparison).item() == pytest.approx(expected, abs=TOLERANCE)


def test_hdr_flip_is_that_of_a_twin_from_the_paper(images):
    reference, image = tensors(*images)
    expected = hdr_flip_map(*images).mean()
    assert 0.1 < expected < 0.7
    score = HDR_FLIP.score(HDR_FLIP.compare(image, reference, reference))
    assert score.item() == pytest.approx(expected, abs=TOLERANCE)


@pytest.mark.parametrize("metric", [FLIP, HDR_FLIP], ids=lambda metric: metric.name)
def test_equal_images_have_no_error_and_a_batch_has_a_score_each(metric, images):
    reference, image = tensors(*images)
    both = torch.cat([reference, image])
    scores = metric.score(metric.compare(both, *[reference.expand_as(both)] * 2))
    assert scores.shape == (2,)
    assert scores[0] == 0
    assert scores[1] > 0.1


@pytest.mark.parametrize("metric", [FLIP, HDR_FLIP], ids=lambda metric: metric.name)
def test_a_pixel_that_is_not_finite_scores_as_the_worst_value(metric, images):
    reference, _ = tensors(*images)
    comparison = metric.compare(reference.clone(), reference, reference)
    comparison.image[0, 1, 5, 5] = math.nan
    worst = reference.clone()
    worst[0, :, 5, 5] = 65504  # the reference is dark there
    expected = metric.score(metric.compare(worst, reference, reference))
    assert metric.score(comparison) == expected > 0


def test_a_black_reference_has_no_hdr_flip_and_does_not_stop_the_next_image(images):
    reference, image = tensors(*images)
    black = torch.zeros_like(reference)
    both = HDR_FLIP.compare(torch.cat([image] * 2), *[torch.cat([black, reference])] * 2)
    scores = HDR_FLIP.score(both)
    assert scores.isnan().tolist() == [True, False]
    assert FLIP.score(FLIP.compare(image, black, black)).item() > 0.5


def test_a_process_that_ends_or_takes_too_long_is_an_error_and_is_started_again():
    white, black = np.ones((8, 8, 3), np.float32), np.zeros((8, 8, 3), np.float32)
    process = FlipProcess()
    with pytest.raises(FlipRefusedError, match="refused HDR images of 8x8 pixels: exit code"):
        process.mean_error(black, white, "HDR")
    assert process.mean_error(white, white, "LDR") == 0
    process._child.kill()
    with pytest.raises(FlipError, match="crashed on LDR images of 8x8 pixels: exit code -9"):
        process.mean_error(white, white, "LDR")
    process.time_limit_s = 0.0
    with pytest.raises(FlipError, match="took more than 0 s for LDR images of 8x8 pixels"):
        process.mean_error(white, black, "LDR")
    process.stop()


def test_an_error_of_the_package_is_no_refusal_and_says_what_it_was():
    white = np.ones((8, 8, 3), np.float32)
    process = FlipProcess()
    with pytest.raises(FlipError, match="failed on LDR images of 8x8 pixels: [A-Z]") as failure:
        process.mean_error(white[..., 0], white[..., 0], "LDR")
    assert not isinstance(failure.value, FlipRefusedError)
    assert process.mean_error(white, white, "LDR") == 0
    process.stop()


def test_a_child_that_ends_with_another_code_is_no_refusal(tmp_path, monkeypatch):
    (tmp_path / "flip_evaluator.py").write_text("raise SystemExit(1)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    white = np.ones((8, 8, 3), np.float32)
    with pytest.raises(FlipError, match="crashed on LDR images of 8x8 pixels: exit code 1") as end:
        FlipProcess().mean_error(white, white, "LDR")
    assert not isinstance(end.value, FlipRefusedError)

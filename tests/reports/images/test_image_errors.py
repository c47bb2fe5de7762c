"""Errors of images in numpy are those of the metrics in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reports.analysis.images import decibels, encode_srgb, luminance, squared_error
from rlbench.ops import color


def test_the_curve_is_that_of_the_core():
    radiance = np.linspace(0, 1, 1001, dtype=np.float32)
    expected = color.encode_srgb(torch.from_numpy(radiance)).numpy()
    assert encode_srgb(radiance) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("method", ["accumulate/contrast", "eaw", "mean"])
def test_the_psnr_of_kept_images_is_that_of_the_run(kept, method):
    for clip in kept.clips:
        image = next(each for each in clip.images if each.method == method)
        for frame, reference in enumerate(clip.reference):
            found = decibels(float(squared_error(image.frames[frame], reference).mean()))
            # images are kept in half floats
            assert found == pytest.approx(kept.psnr(method, clip.name, frame), abs=0.01)


def test_a_pixel_that_is_not_finite_has_the_largest_error():
    image = np.zeros((3, 1, 3), np.float32)
    image[:, 0, 1], image[0, 0, 2] = np.nan, np.inf
    assert squared_error(image, np.zeros_like(image)).tolist() == [[0.0, 1.0, 1.0]]


def test_the_luminance_of_white_is_one():
    assert luminance(np.ones((2, 3, 4, 4))) == pytest.approx(np.ones((2, 4, 4)))

"""The exposure of an image: areas of any size, and the rule of Reinhard et al."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.clips.exposure import area_luminance, exposure_from_areas


def test_areas_are_means_of_tiles():
    image = np.random.default_rng(0).random((24, 40, 3))
    grey = image @ [0.2126, 0.7152, 0.0722]
    expected = [grey[y : y + 3, x : x + 5].mean() for y in range(0, 24, 3) for x in range(0, 40, 5)]
    np.testing.assert_allclose(area_luminance(image), expected, rtol=1e-6)  # weights in float32


@pytest.mark.parametrize("size", [(12, 16), (5, 9), (71, 97)])
def test_an_image_of_any_size_has_64_areas(size):
    np.testing.assert_allclose(
        area_luminance(np.full((*size, 3), 2.0)), np.full(64, 2.0), rtol=1e-6
    )


def test_bright_areas_lower_the_exposure_to_white():
    areas = np.array([0.01] * 80 + [10.0] * 20)
    assert exposure_from_areas(areas) == pytest.approx(0.1)

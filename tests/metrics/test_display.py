"""The display transform: equal to the sRGB curve of kornia, clipped."""

from __future__ import annotations

import kornia
import pytest
import torch

from metrics.display import encode_display


def test_values_within_the_range_equal_the_srgb_of_kornia():
    linear = torch.rand(2, 3, 17, 13, generator=torch.Generator().manual_seed(0)) ** 4
    # float32 powers from two libraries
    torch.testing.assert_close(
        encode_display(linear), kornia.color.linear_rgb_to_rgb(linear), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize(
    ("linear", "srgb"),
    [(-1.0, 0.0), (0.0, 0.0), (0.001, 0.01292), (0.214041, 0.5), (1.0, 1.0), (1e30, 1.0)],
)
def test_known_values(linear, srgb):
    assert float(encode_display(torch.tensor(linear))) == pytest.approx(srgb, abs=1e-5)


def test_nan_stays_nan():
    assert encode_display(torch.tensor(torch.nan)).isnan()

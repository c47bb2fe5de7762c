"""The sRGB curve against kornia and published values; luminance against a loop."""

from __future__ import annotations

import kornia
import pytest
import torch
from torch import Tensor

from rlbench.ops.color import (
    OIDN_LUMINANCE,
    REC709_LUMINANCE,
    SRGB_KNEE,
    decode_srgb,
    encode_srgb,
    luminance,
)

UNIT = torch.linspace(0, 1, 3 * 64 * 64).view(1, 3, 64, 64)


def scalar(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


@pytest.mark.parametrize(
    ("curve", "theirs"),
    [(encode_srgb, kornia.color.linear_rgb_to_rgb), (decode_srgb, kornia.color.rgb_to_linear_rgb)],
)
def test_the_curve_and_its_inverse_equal_those_of_kornia(curve, theirs):
    torch.testing.assert_close(curve(UNIT), theirs(UNIT), atol=1e-6, rtol=0)  # float32 powers


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_decoding_inverts_encoding_also_outside_the_unit_interval(dtype):
    linear = torch.linspace(-0.5, 20, 2001, dtype=dtype)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12  # relative error of two powers
    inverse = decode_srgb(encode_srgb(linear))
    torch.testing.assert_close(inverse, linear, rtol=tolerance, atol=1e-9)


@pytest.mark.parametrize(
    ("linear", "display"),
    [
        (SRGB_KNEE, 12.92 * SRGB_KNEE),  # the knee itself is on the straight line
        (0.18, 0.461356),
        (0.214041, 0.5),
        (1.0, 1.0),
        (4.0, 1.055 * 4 ** (1 / 2.4) - 0.055),  # not clipped
    ],
)
def test_known_values(linear, display):
    assert float(encode_srgb(scalar(linear))) == pytest.approx(display, abs=1e-6)
    assert float(decode_srgb(scalar(display))) == pytest.approx(linear, abs=2e-6)


@pytest.mark.parametrize("curve", [encode_srgb, decode_srgb])
def test_the_curve_has_no_step_at_the_knee(curve):
    knee = SRGB_KNEE if curve is encode_srgb else 12.92 * SRGB_KNEE
    below, above = curve(scalar(knee * (1 - 1e-9))), curve(scalar(knee * (1 + 1e-9)))
    # IEC 61966-2-1 rounds the constants, so that the pieces meet to about 1e-8
    assert abs(float(above - below)) < 1e-7


def test_negative_values_stay_on_the_straight_line():
    negative = torch.linspace(-5, 0, 11, dtype=torch.float64)
    assert torch.equal(encode_srgb(negative), 12.92 * negative)
    assert torch.equal(decode_srgb(negative), negative / 12.92)


@pytest.mark.parametrize("curve", [encode_srgb, decode_srgb])
def test_gradients_are_finite_and_positive(curve):
    x = torch.tensor([-1.0, 0.0, 1e-6, SRGB_KNEE, 0.5, 1.0, 10.0], requires_grad=True)
    curve(x).sum().backward()
    assert (torch.isfinite(x.grad) & (x.grad > 0)).all()


@pytest.mark.parametrize("weights", [REC709_LUMINANCE, OIDN_LUMINANCE])
@pytest.mark.parametrize("shape", [(3, 4, 5), (2, 3, 4, 5), (2, 4, 3, 4, 5)])
def test_luminance_equals_a_loop(weights, shape):
    radiance = 4 * torch.rand(shape, generator=torch.Generator().manual_seed(0))
    expected = torch.zeros(*shape[:-3], 1, *shape[-2:])
    for channel, weight in enumerate(weights):
        expected[..., 0, :, :] += weight * radiance[..., channel, :, :]
    torch.testing.assert_close(luminance(radiance, weights), expected)


def test_luminance_uses_the_six_digit_weights_by_default():
    radiance = torch.rand(1, 3, 4, 5, generator=torch.Generator().manual_seed(0))
    assert torch.equal(luminance(radiance), luminance(radiance, OIDN_LUMINANCE))
    assert not torch.equal(luminance(radiance), luminance(radiance, REC709_LUMINANCE))

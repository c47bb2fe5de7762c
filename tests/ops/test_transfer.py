"""Transfer functions: known values, other libraries, inverses, gradients; luminance by a loop."""

from __future__ import annotations

import math

import kornia
import pytest
import torch

from rlbench.ops.color import (
    OIDN_LUMINANCE,
    REC709_LUMINANCE,
    SRGB_KNEE,
    decode_srgb,
    encode_srgb,
    luminance,
)
from rlbench.ops.transfer import (
    PU_RADIANCE,
    PU_VALUE,
    log_forward,
    log_inverse,
    pu_forward,
    pu_inverse,
    squash_depth,
)

SRGB = (encode_srgb, decode_srgb)
PU = (pu_forward, pu_inverse)
LOG = (log_forward, log_inverse)
RADIANCE = torch.logspace(-8, 4.8, 400, dtype=torch.float64)


@pytest.mark.parametrize(
    ("forward", "radiance", "value"),
    [
        *((pu_forward, *values) for values in ((0.0, 0.0), (0.18, 0.21525), (65504.0, 1.0))),
        (pu_forward, 1e-6, 1.41283765e-3 / 3.13512),
        (pu_forward, 1.0, 0.31891),
        *((log_forward, *values) for values in ((0.0, 0.0), (1.0, 1.0), (1 / 64, 0.166048))),
        (encode_srgb, SRGB_KNEE, 12.92 * SRGB_KNEE),  # the knee itself is on the straight line
        (encode_srgb, 0.18, 0.461356),
        (encode_srgb, 0.214041, 0.5),
        (encode_srgb, 1.0, 1.0),
        (encode_srgb, 4.0, 1.055 * 4 ** (1 / 2.4) - 0.055),  # not clipped
    ],
)
def test_known_values(forward, radiance, value):
    assert float(forward(torch.tensor(radiance))) == pytest.approx(value, abs=5e-6)  # 5 digits


@pytest.mark.parametrize(
    ("curve", "theirs"),
    [(encode_srgb, kornia.color.linear_rgb_to_rgb), (decode_srgb, kornia.color.rgb_to_linear_rgb)],
)
def test_the_curve_of_srgb_and_its_inverse_equal_those_of_kornia(curve, theirs):
    unit = torch.linspace(0, 1, 3 * 64 * 64).view(1, 3, 64, 64)
    torch.testing.assert_close(curve(unit), theirs(unit), atol=1e-6, rtol=0)  # float32 powers


@pytest.mark.parametrize(
    ("dtype", "tolerance"),
    [
        (torch.float64, 1e-5),  # breakpoints and constants of PU are given to nine digits
        (torch.float32, 1e-4),  # 24 bits for values near 1; the logarithm of PU spans 16 nats
    ],
)
@pytest.mark.parametrize(("forward", "inverse"), [SRGB, PU, LOG])
def test_the_inverse_of_forward_is_the_identity(forward, inverse, dtype, tolerance):
    radiance = RADIANCE[(RADIANCE > 1e-4) | (dtype == torch.float64)].to(dtype)
    torch.testing.assert_close(inverse(forward(radiance)), radiance, rtol=tolerance, atol=0)


@pytest.mark.parametrize(
    ("pair", "slope"), [(SRGB, 12.92), (PU, 1.41283765e03 / 3.13512)], ids=["srgb", "pu"]
)
def test_negative_values_stay_on_the_straight_line(pair, slope):
    forward, inverse = pair
    negative = torch.linspace(-5, 0, 11, dtype=torch.float64)
    torch.testing.assert_close(forward(negative), slope * negative, rtol=1e-6, atol=0)
    torch.testing.assert_close(inverse(negative), negative / slope, rtol=1e-6, atol=0)


@pytest.mark.parametrize("forward", [encode_srgb, pu_forward, log_forward])
def test_transfer_functions_increase_everywhere(forward):
    assert (forward(RADIANCE).diff() > 0).all()


@pytest.mark.parametrize(
    ("curve", "at", "value"),
    [
        # IEC 61966-2-1 rounds the constants, so that the pieces meet to about 1e-8
        (encode_srgb, SRGB_KNEE, 12.92 * SRGB_KNEE),
        (decode_srgb, 12.92 * SRGB_KNEE, SRGB_KNEE),
        # those of the fit of PU to about 1e-7
        (pu_forward, PU_RADIANCE[0], PU_VALUE[0] / 3.13512),
        (pu_forward, PU_RADIANCE[1], PU_VALUE[1] / 3.13512),
    ],
)
def test_the_pieces_of_a_curve_meet(curve, at, value):
    below, above = curve(torch.tensor([at * (1 - 1e-9), at * (1 + 1e-9)], dtype=torch.float64))
    assert float((above - below).abs()) < (1e-6 if curve is pu_forward else 1e-7)
    assert float(above) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("function", [*SRGB, *PU])
def test_gradients_are_finite_and_positive(function):
    x = torch.tensor([-1.0, 0.0, 1e-7, 1e-4, SRGB_KNEE, 0.03, 0.5, 1.0], requires_grad=True)
    function(x).sum().backward()
    assert (torch.isfinite(x.grad) & (x.grad > 0)).all()


def test_squashed_depth_is_one_at_the_camera_and_zero_for_background():
    depth = torch.tensor([0.0, 1.0, math.inf]).view(1, 1, 1, 3)
    assert squash_depth(depth).flatten().tolist() == [1.0, 0.5, 0.0]


@pytest.mark.parametrize(
    ("options", "weights"),
    [({}, OIDN_LUMINANCE), ({"weights": REC709_LUMINANCE}, REC709_LUMINANCE)],
)
@pytest.mark.parametrize("shape", [(3, 4, 5), (2, 3, 4, 5), (2, 4, 3, 4, 5)])
def test_luminance_equals_a_loop_with_six_digit_weights_by_default(options, weights, shape):
    radiance = 4 * torch.rand(shape, generator=torch.Generator().manual_seed(0))
    expected = torch.zeros(*shape[:-3], 1, *shape[-2:])
    for channel, weight in enumerate(weights):
        expected[..., 0, :, :] += weight * radiance[..., channel, :, :]
    torch.testing.assert_close(luminance(radiance, **options), expected)

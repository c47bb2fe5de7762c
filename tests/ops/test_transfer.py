"""Transfer functions: known values, inverses, continuity, gradients."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.ops.transfer import (
    PU_RADIANCE,
    PU_VALUE,
    log_forward,
    log_inverse,
    pu_forward,
    pu_inverse,
    squash_depth,
)

RADIANCE = torch.logspace(-8, 4.8, 400, dtype=torch.float64)


PU_VALUES = [(0.0, 0.0), (1e-6, 1.41283765e-3 / 3.13512), (0.18, 0.21525), (1.0, 0.31891)]


@pytest.mark.parametrize(
    ("forward", "radiance", "value"),
    [(pu_forward, *values) for values in [*PU_VALUES, (65504.0, 1.0)]]
    + [(log_forward, *values) for values in [(0.0, 0.0), (1.0, 1.0), (1 / 64, 0.166048)]],
)
def test_known_values(forward, radiance, value):
    assert float(forward(torch.tensor(radiance))) == pytest.approx(value, abs=5e-6)  # 5 digits


@pytest.mark.parametrize(
    ("dtype", "tolerance"),
    [
        (torch.float64, 1e-5),  # breakpoints and constants of PU are given to nine digits
        (torch.float32, 1e-4),  # 24 bits for values near 1; the logarithm of PU spans 16 nats
    ],
)
@pytest.mark.parametrize(
    ("forward", "inverse"), [(pu_forward, pu_inverse), (log_forward, log_inverse)]
)
def test_the_inverse_of_forward_is_the_identity(forward, inverse, dtype, tolerance):
    radiance = RADIANCE[(RADIANCE > 1e-4) | (dtype == torch.float64)].to(dtype)
    torch.testing.assert_close(inverse(forward(radiance)), radiance, rtol=tolerance, atol=0)


@pytest.mark.parametrize("forward", [pu_forward, log_forward])
def test_transfer_functions_increase_everywhere(forward):
    assert (forward(RADIANCE).diff() > 0).all()


@pytest.mark.parametrize(("at", "value"), zip(PU_RADIANCE, PU_VALUE, strict=True))
def test_pu_and_its_inverse_have_the_same_breakpoints_without_a_step(at, value):
    below, above = pu_forward(torch.tensor([at * (1 - 1e-9), at * (1 + 1e-9)], dtype=torch.float64))
    assert float(above - below) < 1e-6  # the pieces of the fit meet to about 1e-7
    assert float(above) * 3.13512 == pytest.approx(value, rel=1e-5)


def test_pu_inverts_negative_values_too():
    value = torch.linspace(-2, 0, 9, dtype=torch.float64)
    torch.testing.assert_close(pu_forward(pu_inverse(value)), value)


@pytest.mark.parametrize("function", [pu_forward, pu_inverse])
def test_gradients_of_pu_are_finite_and_positive(function):
    x = torch.tensor([0.0, 1e-7, 1e-4, 0.03, 0.5, 1.0], requires_grad=True)
    function(x).sum().backward()
    assert (torch.isfinite(x.grad) & (x.grad > 0)).all()


def test_squashed_depth_is_one_at_the_camera_and_zero_for_background():
    depth = torch.tensor([0.0, 1.0, math.inf]).view(1, 1, 1, 3)
    assert squash_depth(depth).flatten().tolist() == [1.0, 0.5, 0.0]

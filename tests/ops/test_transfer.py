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


@pytest.mark.parametrize(
    ("radiance", "value"),
    [(0.0, 0.0), (1e-6, 1.41283765e-3 / 3.13512), (0.18, 0.21525), (1.0, 0.31891), (65504.0, 1.0)],
)
def test_pu_has_the_published_values(radiance, value):
    assert float(pu_forward(torch.tensor(radiance))) == pytest.approx(value, abs=5e-6)  # 5 digits


@pytest.mark.parametrize(
    ("forward", "inverse"), [(pu_forward, pu_inverse), (log_forward, log_inverse)]
)
def test_inverse_of_forward_is_identity(forward, inverse):
    # breakpoints and constants of PU are given to nine digits
    torch.testing.assert_close(inverse(forward(RADIANCE)), RADIANCE, rtol=1e-5, atol=0)


@pytest.mark.parametrize(
    ("forward", "inverse"), [(pu_forward, pu_inverse), (log_forward, log_inverse)]
)
def test_float32_keeps_four_digits_of_radiance(forward, inverse):
    radiance = RADIANCE[RADIANCE > 1e-4].float()
    # 24 bits for values near 1; the logarithm of PU spans 16 nats
    torch.testing.assert_close(inverse(forward(radiance)), radiance, rtol=1e-4, atol=0)


@pytest.mark.parametrize("forward", [pu_forward, log_forward])
def test_transfer_functions_increase_everywhere(forward):
    assert (forward(RADIANCE).diff() > 0).all()


@pytest.mark.parametrize("at", PU_RADIANCE)
def test_pu_is_continuous_at_its_breakpoints(at):
    below, above = pu_forward(torch.tensor([at * (1 - 1e-9), at * (1 + 1e-9)], dtype=torch.float64))
    assert float(above - below) < 1e-6  # the pieces of the fit meet to about 1e-7


@pytest.mark.parametrize("at", PU_VALUE)
def test_the_inverse_of_pu_has_the_same_breakpoints(at):
    radiance = PU_RADIANCE[PU_VALUE.index(at)]
    value = float(pu_forward(torch.tensor(radiance, dtype=torch.float64))) * 3.13512
    assert value == pytest.approx(at, rel=1e-5)


def test_pu_inverts_negative_values_too():
    value = torch.linspace(-2, 0, 9, dtype=torch.float64)
    torch.testing.assert_close(pu_forward(pu_inverse(value)), value)


@pytest.mark.parametrize("function", [pu_forward, pu_inverse])
def test_gradients_of_pu_are_finite_and_positive(function):
    x = torch.tensor([0.0, 1e-7, 1e-4, 0.03, 0.5, 1.0], requires_grad=True)
    function(x).sum().backward()
    assert x.grad is not None
    assert (torch.isfinite(x.grad) & (x.grad > 0)).all()


@pytest.mark.parametrize(("radiance", "value"), [(0.0, 0.0), (1.0, 1.0), (1 / 64, 0.166048)])
def test_log_has_the_values_of_its_closed_form(radiance, value):
    assert float(log_forward(torch.tensor(radiance))) == pytest.approx(value, abs=1e-5)


def test_squashed_depth_is_one_at_the_camera_and_zero_for_background():
    depth = torch.tensor([0.0, 1.0, math.inf]).view(1, 1, 1, 3)
    assert squash_depth(depth).flatten().tolist() == [1.0, 0.5, 0.0]
